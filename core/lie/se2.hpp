// SE(2): planar poses, stored in arrays as (x, y, theta).
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <memory>
#include <numbers>

#include "lie/sincos.hpp"

namespace masat {

// Angle in [-pi, pi), as g2o normalizes it.
inline double wrap_angle(double theta) {
  constexpr double pi = std::numbers::pi, two_pi = 2 * pi;
  if (theta >= -pi && theta < pi) return theta;
  // The next turn up or down is the common case, and its subtraction exact.
  if (theta >= pi && theta < 3 * pi) return theta - two_pi;
  if (theta < -pi && theta >= -3 * pi) return theta + two_pi;
  const double wrapped = std::remainder(theta, two_pi);
  return wrapped >= pi ? wrapped - two_pi : wrapped;
}

struct SE2 {
  static constexpr int kDof = 3;
  static constexpr int kSize = 3;
  using Tangent = Eigen::Matrix<double, kDof, 1>;
  using Square = Eigen::Matrix<double, kDof, kDof>;

  double x = 0, y = 0, theta = 0;
  double c = 1, s = 0;  // of theta: one sine-cosine pair a pose, however often it is used

  static SE2 load(const double* p) {
    const SinCos r = sincos(p[2]);
    return {p[0], p[1], p[2], r.cos, r.sin};
  }
  class Table;
  void store(double* p) const {
    p[0] = x;
    p[1] = y;
    p[2] = wrap_angle(theta);
  }

  SE2 operator*(const SE2& b) const {
    return {x + c * b.x - s * b.y, y + s * b.x + c * b.y, theta + b.theta, c * b.c - s * b.s,
            s * b.c + c * b.s};
  }
  SE2 inverse() const { return {-c * x - s * y, s * x - c * y, -theta, c, -s}; }

  static constexpr int kDimension = 2;
  using Rotation = Eigen::Matrix2d;
  Rotation rotation() const { return (Rotation() << c, -s, s, c).finished(); }
  // At the origin, with the rotation nearest to a matrix: Re(trace) and curl give its heading.
  static SE2 nearest(const Rotation& m) {
    const double sine = m(1, 0) - m(0, 1), cosine = m(0, 0) + m(1, 1);
    const double pose[] = {0, 0, sine == 0 && cosine == 0 ? 0.0 : std::atan2(sine, cosine)};
    return load(pose);
  }

  // this * (dx, dy, dtheta)
  static SE2 from_tangent(const double* d) { return load(d); }

  using Vector = Eigen::Vector2d;
  Vector translation() const { return {x, y}; }
  // The same rotation at another translation.
  SE2 at(const Vector& to) const { return {to.x(), to.y(), theta, c, s}; }

  class Mean;
  class Turn;
};

// An array of poses with the trigonometry done in one pass.
class SE2::Table {
 public:
  Table() = default;
  Table(const double* poses, std::int64_t count) {
    view(poses, count);
    prepare(0, count);
  }
  void view(const double* poses, std::int64_t count) {
    poses_ = poses;
    if (count > capacity_) {
      rotations_ = std::make_unique_for_overwrite<SinCos[]>(count);
      capacity_ = count;
    }
  }
  void prepare(std::int64_t begin, std::int64_t end) {
    sincos(poses_ + 2 + kSize * begin, kSize, end - begin, rotations_.get() + begin);
  }
  SE2 operator[](std::int64_t k) const {
    const double* const p = poses_ + kSize * k;
    return {p[0], p[1], p[2], rotations_[k].cos, rotations_[k].sin};
  }

 private:
  const double* poses_ = nullptr;
  std::unique_ptr<SinCos[]> rotations_;
  std::int64_t capacity_ = 0;
};

// Average of poses: mean position; direction of the mean unit vector of the headings.
class SE2::Mean {
 public:
  explicit Mean(const SE2& first) : sum_(first), first_(first) {}
  void add(const SE2& p) {
    sum_.x += p.x;
    sum_.y += p.y;
    sum_.c += p.c;
    sum_.s += p.s;
    ++count_;
  }
  SE2 get() const {
    if (count_ == 1) return first_;
    const double norm = std::sqrt(sum_.c * sum_.c + sum_.s * sum_.s), k = 1.0 / count_;
    // Headings that cancel have no mean: the first one is kept.
    if (norm == 0) return {sum_.x * k, sum_.y * k, first_.theta, first_.c, first_.s};
    return {sum_.x * k, sum_.y * k, std::atan2(sum_.s, sum_.c), sum_.c / norm, sum_.s / norm};
  }

 private:
  SE2 sum_, first_;
  int count_ = 1;
};

// The rotation of a pose; operator() returns a fraction of it.
class SE2::Turn {
 public:
  explicit Turn(const SE2& p) : angle_(wrap_angle(p.theta)) {}
  SE2 operator()(double fraction) const {
    const double d[kSize] = {0, 0, fraction * angle_};
    return load(d);
  }

 private:
  double angle_;
};

namespace detail {
// b's position in the frame of a.
inline SE2::Vector position_in(const SE2& a, const SE2& b) {
  const double dx = b.x - a.x, dy = b.y - a.y;
  return {a.c * dx + a.s * dy, a.c * dy - a.s * dx};
}
// The error of b at a position in the frame of a.
inline SE2::Tangent error_at(const SE2::Vector& position, const SE2& z, const SE2& a,
                             const SE2& b) {
  const double u = position.x() - z.x, v = position.y() - z.y;
  return {z.c * u + z.s * v, z.c * v - z.s * u, wrap_angle(b.theta - a.theta - z.theta)};
}
}  // namespace detail

// g2o's EDGE_SE2 error: (x, y, theta) of z^-1 (a^-1 b).
inline SE2::Tangent error(const SE2& z, const SE2& a, const SE2& b) {
  return detail::error_at(detail::position_in(a, b), z, a, b);
}

// The error and its derivatives with respect to a * da and b * db at da = db = 0.
inline SE2::Tangent error(const SE2& z, const SE2& a, const SE2& b, SE2::Square& da,
                          SE2::Square& db) {
  const SE2::Vector p = detail::position_in(a, b);
  da << -z.c, -z.s, z.c * p.y() - z.s * p.x(),  //
      z.s, -z.c, -z.s * p.y() - z.c * p.x(),    //
      0, 0, -1;
  const double c = a.c * b.c + a.s * b.s, s = a.c * b.s - a.s * b.c;  // heading of b in a
  const double ec = z.c * c + z.s * s, es = z.c * s - z.s * c;        // and in z
  db << ec, -es, 0,                                                   //
      es, ec, 0,                                                      //
      0, 0, 1;
  return detail::error_at(p, z, a, b);
}

// The derivative of the step that a * o takes when a takes one, o^-1 da o, at da = 0.
inline SE2::Square step_at(const SE2& o) {
  SE2::Square m;
  m << o.c, o.s, o.s * o.x - o.c * o.y,  //
      -o.s, o.c, o.c * o.x + o.s * o.y,  //
      0, 0, 1;
  return m;
}

}  // namespace masat
