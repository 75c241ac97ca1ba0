// Measurements of the pose of one node in the frame of another: the edges of a pose graph.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>

#include "factors/loss.hpp"
#include "graph/topology.hpp"
#include "lie/group.hpp"

namespace masat {

// A table of factors. Each kind has size(), edges(), cost(k, poses), and linearize(k, poses,
// losses, adder), where poses[node] is a pose and the adder that of a NormalSystem. What the
// constructor is given is not copied and must outlive the table; without information there are
// residuals alone.
template <LieGroup Group>
class RelativePoseFactors {
 public:
  using Tangent = typename Group::Tangent;
  using Square = typename Group::Square;

  RelativePoseFactors(std::span<const Edge> edges, const double* measurements,
                      const double* information = nullptr)
      : edges_(edges),
        measured_(measurements, static_cast<std::int64_t>(edges.size())),
        information_(information) {}

  std::int64_t size() const { return static_cast<std::int64_t>(edges_.size()); }
  std::span<const Edge> edges() const { return edges_; }

  template <class Poses>
  Tangent residual(std::int64_t k, const Poses& poses) const {
    return error(measured_[k], poses[edges_[k].from], poses[edges_[k].to]);
  }

  // e' W e
  template <class Poses>
  double cost(std::int64_t k, const Poses& poses) const {
    const Tangent e = residual(k, poses);
    return e.dot(information(k) * e);
  }

  // Adds the factor to a system and returns its cost.
  template <class Poses, class Adder>
  [[gnu::always_inline]] double linearize(std::int64_t k, const Poses& poses,
                                          const EdgeLosses& losses, Adder& adder) const {
    Square from, to;
    const Tangent e = error(measured_[k], poses[edges_[k].from], poses[edges_[k].to], from, to);
    const bool robust = losses.robust(k);
    LossValue value{0, losses.weight(k)};
    if (robust) value = losses.loss()(e.dot(information(k) * e));
    const Square w = value.weight * information(k);
    const Tangent we = w * e;
    adder.add_edge(from, to, w, we);
    return robust ? value.cost : e.dot(we);
  }

 private:
  Eigen::Map<const Square> information(std::int64_t k) const {
    return Eigen::Map<const Square>(information_ + k * Group::kDof * Group::kDof);
  }

  std::span<const Edge> edges_;
  typename Group::Table measured_;
  const double* information_;
};

}  // namespace masat
