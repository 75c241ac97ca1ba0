// Edges that may measure a sensor on a node, or the range and bearing of a landmark.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>

#include "factors/loss.hpp"
#include "factors/range_bearing.hpp"
#include "graph/topology.hpp"
#include "lie/group.hpp"

namespace masat {

// A table of factors as RelativePoseFactors, with two more columns, each of which may be null.
// `offsets`: an edge measures the pose b * o of a sensor in the place of the pose b of the node
// that it leads to. `range_bearing`: where it is true, the x axis of the measured pose points at
// the measured position, and in the place of the translation the error has that of its distance and
// direction.
template <LieGroup Group>
class SensorFactors {
 public:
  using Tangent = typename Group::Tangent;
  using Square = typename Group::Square;

  SensorFactors(std::span<const Edge> edges, const double* measurements, const double* information,
                const double* offsets, const bool* range_bearing)
      : edges_(edges),
        measured_(measurements),
        information_(information),
        offsets_(offsets),
        range_bearing_(range_bearing) {}

  std::int64_t size() const { return static_cast<std::int64_t>(edges_.size()); }
  std::span<const Edge> edges() const { return edges_; }

  template <class Poses>
  Tangent residual(std::int64_t k, const Poses& poses) const {
    const Group z = measured(k);
    const Group& a = poses[edges_[k].from];
    const Group& b = poses[edges_[k].to];
    Tangent e = offsets_ ? error(z, a, b * offset(k)) : error(z, a, b);
    if (is_range_bearing(k)) {
      const double range = z.translation().norm();
      e.template head<d>() = range_bearing_error<d>(ahead(e, range), range);
    }
    return e;
  }

  template <class Poses>
  double cost(std::int64_t k, const Poses& poses) const {
    const Tangent e = residual(k, poses);
    return e.dot(information(k) * e);
  }

  template <class Poses, class Adder>
  double linearize(std::int64_t k, const Poses& poses, const EdgeLosses& losses,
                   Adder& adder) const {
    Square from, to;
    const Group z = measured(k);
    const Group& a = poses[edges_[k].from];
    const Group& b = poses[edges_[k].to];
    Tangent e;
    if (offsets_) {
      const Group o = offset(k);
      e = error(z, a, b * o, from, to);
      to = (to * step_at(o)).eval();
    } else {
      e = error(z, a, b, from, to);
    }
    if (is_range_bearing(k)) {
      const double range = z.translation().norm();
      Eigen::Matrix<double, d, d> j;
      e.template head<d>() = range_bearing_error<d>(ahead(e, range), range, &j);
      from.template topRows<d>() = (j * from.template topRows<d>()).eval();
      to.template topRows<d>() = (j * to.template topRows<d>()).eval();
    }
    const double chi2 = e.dot(information(k) * e);
    const LossValue value = losses.robust(k) ? losses.loss()(chi2)
                                             : LossValue{losses.weight(k) * chi2, losses.weight(k)};
    const Square w = value.weight * information(k);
    adder.add_edge(from, to, w, Tangent(w * e));
    return value.cost;
  }

 private:
  static constexpr int d = Group::kDimension;

  Group measured(std::int64_t k) const { return Group::load(measured_ + k * Group::kSize); }
  Group offset(std::int64_t k) const { return Group::load(offsets_ + k * Group::kSize); }
  bool is_range_bearing(std::int64_t k) const { return range_bearing_ && range_bearing_[k]; }
  Eigen::Map<const Square> information(std::int64_t k) const {
    return Eigen::Map<const Square>(information_ + k * Group::kDof * Group::kDof);
  }
  // The position in the frame that points along the measured direction, from the error of a pose
  // measured at that range.
  static Eigen::Matrix<double, d, 1> ahead(const Tangent& e, double range) {
    Eigen::Matrix<double, d, 1> q = e.template head<d>();
    q[0] += range;
    return q;
  }

  std::span<const Edge> edges_;
  const double* measured_;
  const double* information_;
  const double* offsets_;
  const bool* range_bearing_;
};

}  // namespace masat
