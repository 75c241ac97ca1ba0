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

// What was measured in the place of the pose b of the node that an edge leads to: the pose b *
// offset of a sensor on it; or where `range_bearing` is true, the x axis of the measured pose
// points at the measured position, and in the place of the translation the error has that of its
// distance and direction.
template <LieGroup Group>
struct Sensor {
  bool has_offset = false, range_bearing = false;
  Group offset = {};
};

namespace detail {

// Makes the error of a pose that of range and bearing; `jacobian` gets the derivative by the
// translation.
template <LieGroup Group>
void to_range_bearing(
    const Group& z, typename Group::Tangent& e,
    Eigen::Matrix<double, Group::kDimension, Group::kDimension>* jacobian = nullptr) {
  constexpr int d = Group::kDimension;
  const double range = z.translation().norm();
  // The position in the frame that points along the measured direction.
  Eigen::Matrix<double, d, 1> ahead = e.template head<d>();
  ahead[0] += range;
  e.template head<d>() = range_bearing_error<d>(ahead, range, jacobian);
}

}  // namespace detail

template <LieGroup Group>
typename Group::Tangent sensor_error(const Group& z, const Group& a, const Group& b,
                                     const Sensor<Group>& sensor) {
  typename Group::Tangent e = sensor.has_offset ? error(z, a, b * sensor.offset) : error(z, a, b);
  if (sensor.range_bearing) detail::to_range_bearing(z, e);
  return e;
}

// The same with the derivatives by the steps of both nodes.
template <LieGroup Group>
typename Group::Tangent sensor_error(const Group& z, const Group& a, const Group& b,
                                     const Sensor<Group>& sensor, typename Group::Square& from,
                                     typename Group::Square& to) {
  constexpr int d = Group::kDimension;
  typename Group::Tangent e;
  if (sensor.has_offset) {
    e = error(z, a, b * sensor.offset, from, to);
    to = (to * step_at(sensor.offset)).eval();
  } else {
    e = error(z, a, b, from, to);
  }
  if (sensor.range_bearing) {
    Eigen::Matrix<double, d, d> j;
    detail::to_range_bearing(z, e, &j);
    from.template topRows<d>() = (j * from.template topRows<d>()).eval();
    to.template topRows<d>() = (j * to.template topRows<d>()).eval();
  }
  return e;
}

// A table of factors as RelativePoseFactors, with two more columns, each of which may be null:
// the offsets of the sensors, and which edges measure range and bearing.
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
    return sensor_error(measured(k), poses[edges_[k].from], poses[edges_[k].to], sensor(k));
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
    const Tangent e =
        sensor_error(measured(k), poses[edges_[k].from], poses[edges_[k].to], sensor(k), from, to);
    const double chi2 = e.dot(information(k) * e);
    const LossValue value = losses.robust(k) ? losses.loss()(chi2)
                                             : LossValue{losses.weight(k) * chi2, losses.weight(k)};
    const Square w = value.weight * information(k);
    adder.add_edge(from, to, w, Tangent(w * e));
    return value.cost;
  }

 private:
  Group measured(std::int64_t k) const { return Group::load(measured_ + k * Group::kSize); }
  Sensor<Group> sensor(std::int64_t k) const {
    Sensor<Group> out{offsets_ != nullptr, range_bearing_ && range_bearing_[k]};
    if (offsets_) out.offset = Group::load(offsets_ + k * Group::kSize);
    return out;
  }
  Eigen::Map<const Square> information(std::int64_t k) const {
    return Eigen::Map<const Square>(information_ + k * Group::kDof * Group::kDof);
  }

  std::span<const Edge> edges_;
  const double* measured_;
  const double* information_;
  const double* offsets_;
  const bool* range_bearing_;
};

}  // namespace masat
