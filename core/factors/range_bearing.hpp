// The distance and the direction of a point beside those that were measured.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

namespace masat {

// The error of a point at `q`, in a frame whose x axis is the measured direction: its distance
// minus the range; then the angle between its direction and the x axis, as components along the
// other axes. In 2D this is the difference of the bearings. `jacobian`, if given, gets the
// derivative by q.
//
// Everything is finite: on the sensor the point counts as ahead, and right behind it, where the
// direction of the angle is not defined, as turned toward the y axis.
template <int d>
Eigen::Matrix<double, d, 1> range_bearing_error(const Eigen::Matrix<double, d, 1>& q, double range,
                                                Eigen::Matrix<double, d, d>* jacobian = nullptr) {
  // Meters: a point that is nearer to the sensor, or to the line through it, counts as there.
  constexpr double kTouching = 1e-12;
  using Side = Eigen::Matrix<double, d - 1, 1>;
  const double x = q[0];
  const Side v = q.template tail<d - 1>();
  const double aside = v.norm(), distance = std::hypot(x, aside);
  Eigen::Matrix<double, d, 1> e;
  e[0] = distance - range;
  if (distance < kTouching) {
    e.template tail<d - 1>().setZero();
    if (jacobian) {
      jacobian->setZero();
      (*jacobian)(0, 0) = 1;
    }
    return e;
  }
  const double angle = std::atan2(aside, x);
  Side toward = Side::Unit(0);
  if (aside > 0) toward = v / aside;
  e.template tail<d - 1>() = angle * toward;
  if (jacobian) {
    const double squared = distance * distance;
    // The angle grows by the first along `toward`; across, the direction turns by the second.
    const double along = x / squared;
    const double across = aside < kTouching && x > 0 ? along : angle / std::max(aside, kTouching);
    (*jacobian)(0, 0) = x / distance;
    jacobian->template topRightCorner<1, d - 1>() = v.transpose() / distance;
    jacobian->template bottomLeftCorner<d - 1, 1>() = -v / squared;
    jacobian->template bottomRightCorner<d - 1, d - 1>().setIdentity();
    jacobian->template bottomRightCorner<d - 1, d - 1>() *= across;
    if constexpr (d == 2) {
      (*jacobian)(1, 1) = along;
    } else {
      jacobian->template bottomRightCorner<d - 1, d - 1>() +=
          (along - across) * toward * toward.transpose();
    }
  }
  return e;
}

}  // namespace masat
