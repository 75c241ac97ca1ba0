// Measurements of a sensor on a node in the frame of another node.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>

#include "factors/loss.hpp"
#include "graph/topology.hpp"
#include "lie/group.hpp"

namespace masat {

// A table of factors as RelativePoseFactors, but an edge measures the pose b * o of a sensor in the
// place of the pose b of the node that it leads to. `offsets` are the o, one an edge.
template <LieGroup Group>
class OffsetPoseFactors {
 public:
  using Tangent = typename Group::Tangent;
  using Square = typename Group::Square;

  OffsetPoseFactors(std::span<const Edge> edges, const double* measurements,
                    const double* information, const double* offsets)
      : edges_(edges), measured_(measurements), information_(information), offsets_(offsets) {}

  std::int64_t size() const { return static_cast<std::int64_t>(edges_.size()); }

  template <class Poses>
  Tangent residual(std::int64_t k, const Poses& poses) const {
    return error(measured(k), poses[edges_[k].from], poses[edges_[k].to] * offset(k));
  }

  template <class Poses>
  double cost(std::int64_t k, const Poses& poses) const {
    const Tangent e = residual(k, poses);
    return e.dot(information(k) * e);
  }

  template <class Poses, class System>
  double linearize(std::int64_t k, const Poses& poses, const EdgeLosses& losses,
                   System& system) const {
    Square from, to;
    const Group o = offset(k);
    const Tangent e = error(measured(k), poses[edges_[k].from], poses[edges_[k].to] * o, from, to);
    to = (to * step_at(o)).eval();
    const double chi2 = e.dot(information(k) * e);
    const LossValue value = losses.robust(k) ? losses.loss()(chi2)
                                             : LossValue{losses.weight(k) * chi2, losses.weight(k)};
    const Square w = value.weight * information(k);
    system.add_edge(k, edges_[k], from, to, w, Tangent(w * e));
    return value.cost;
  }

 private:
  Group measured(std::int64_t k) const { return Group::load(measured_ + k * Group::kSize); }
  Group offset(std::int64_t k) const { return Group::load(offsets_ + k * Group::kSize); }
  Eigen::Map<const Square> information(std::int64_t k) const {
    return Eigen::Map<const Square>(information_ + k * Group::kDof * Group::kDof);
  }

  std::span<const Edge> edges_;
  const double* measured_;
  const double* information_;
  const double* offsets_;
};

}  // namespace masat
