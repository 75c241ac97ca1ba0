// SE(3): spatial poses, stored in arrays as (x, y, z, qx, qy, qz, qw).
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <cmath>
#include <cstdint>

#include "lie/sincos.hpp"

namespace masat {

struct SE3 {
  static constexpr int kDof = 6;
  static constexpr int kSize = 7;
  using Tangent = Eigen::Matrix<double, kDof, 1>;
  using Square = Eigen::Matrix<double, kDof, kDof>;

  Eigen::Vector3d t = Eigen::Vector3d::Zero();
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();

  static SE3 load(const double* p) {
    return {Eigen::Map<const Eigen::Vector3d>(p), Eigen::Quaterniond(p + 3)};
  }
  class Table;
  void store(double* p) const {
    Eigen::Map<Eigen::Vector3d>{p} = t;
    Eigen::Map<Eigen::Vector4d>{p + 3} = q.coeffs().normalized();
  }

  SE3 operator*(const SE3& b) const { return {t + q * b.t, q * b.q}; }
  SE3 inverse() const { return {-(q.conjugate() * t), q.conjugate()}; }

  static constexpr int kDimension = 3;
  using Rotation = Eigen::Matrix3d;
  Rotation rotation() const { return q.toRotationMatrix(); }
  // At the origin, with the rotation nearest to a matrix (Umeyama, PAMI 1991).
  static SE3 nearest(const Rotation& m) {
    const Eigen::JacobiSVD<Rotation> svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Rotation u = svd.matrixU();
    if ((u * svd.matrixV().transpose()).determinant() < 0) u.col(2) = -u.col(2);
    return {Eigen::Vector3d::Zero(), Eigen::Quaterniond(Rotation(u * svd.matrixV().transpose()))};
  }

  // (translation, vector part of the unit quaternion), g2o's minimal parametrization. A vector
  // part longer than 1 belongs to no rotation: the half turn about it is the nearest.
  static SE3 from_tangent(const double* d) {
    Eigen::Vector3d v(d[3], d[4], d[5]);
    const double squared = v.squaredNorm();
    double w = 0;
    if (squared < 1) {
      w = std::sqrt(1 - squared);
    } else {
      v /= std::sqrt(squared);
    }
    return {Eigen::Map<const Eigen::Vector3d>(d), Eigen::Quaterniond(w, v.x(), v.y(), v.z())};
  }

  using Vector = Eigen::Vector3d;
  const Vector& translation() const { return t; }
  // The same rotation at another translation.
  SE3 at(const Vector& to) const { return {to, q}; }

  class Mean;
  class Turn;
};

// An array of poses.
class SE3::Table {
 public:
  Table() = default;
  Table(const double* poses, std::int64_t count) { view(poses, count); }
  void view(const double* poses, std::int64_t) { poses_ = poses; }
  void prepare(std::int64_t, std::int64_t) {}
  SE3 operator[](std::int64_t k) const { return load(poses_ + kSize * k); }

 private:
  const double* poses_ = nullptr;
};

// Average of poses: mean position; mean of the unit quaternions, each with the sign that lies
// nearer to the first one.
class SE3::Mean {
 public:
  explicit Mean(const SE3& first) : sum_(first), first_(first.q) {}
  void add(const SE3& p) {
    sum_.t += p.t;
    if (first_.dot(p.q) < 0) {
      sum_.q.coeffs() -= p.q.coeffs();
    } else {
      sum_.q.coeffs() += p.q.coeffs();
    }
    ++count_;
  }
  // Each addend has a non-negative product with the first: the sum cannot vanish.
  SE3 get() const { return {sum_.t / count_, sum_.q.normalized()}; }

 private:
  SE3 sum_;
  Eigen::Quaterniond first_;
  int count_ = 1;
};

namespace detail {
inline Eigen::Quaterniond with_positive_w(const Eigen::Quaterniond& q) {
  return q.w() < 0 ? Eigen::Quaterniond(-q.coeffs()) : q;
}
inline Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(),  //
      v.z(), 0, -v.x(),   //
      -v.y(), v.x(), 0;
  return m;
}
}  // namespace detail

// The rotation of a pose; operator() returns a fraction of it, by the shorter way about its axis.
class SE3::Turn {
 public:
  explicit Turn(const SE3& p) {
    const Eigen::Quaterniond q = detail::with_positive_w(p.q);
    const double sine = q.vec().norm();
    half_ = std::atan2(sine, q.w());
    if (sine > 0) axis_ = q.vec() / sine;
  }
  SE3 operator()(double fraction) const {
    const SinCos r = sincos(fraction * half_);
    const Eigen::Vector3d v = r.sin * axis_;
    return {Eigen::Vector3d::Zero(), Eigen::Quaterniond(r.cos, v.x(), v.y(), v.z())};
  }

 private:
  Eigen::Vector3d axis_ = Eigen::Vector3d::Zero();
  double half_ = 0;  // of the angle
};

namespace detail {
// b's position in the frame of a.
inline Eigen::Vector3d position_in(const SE3& a, const SE3& b) {
  return a.q.conjugate() * (b.t - a.t);
}
// The rotation of z^-1 (a^-1 b), with w >= 0.
inline Eigen::Quaterniond rotation_error(const SE3& z, const SE3& a, const SE3& b) {
  return with_positive_w(z.q.conjugate() * (a.q.conjugate() * b.q));
}
// The error of a position in the frame of a, and of a rotation error. `back` is the inverse
// rotation of z, as a quaternion or a matrix.
template <class Rotation>
SE3::Tangent error_at(const Eigen::Vector3d& position, const Eigen::Quaterniond& rotation,
                      const SE3& z, const Rotation& back) {
  SE3::Tangent e;
  e.head<3>() = back * (position - z.t);
  e.tail<3>() = rotation.vec();
  return e;
}
}  // namespace detail

// g2o's EDGE_SE3:QUAT error: (translation, vector part of the quaternion with w >= 0) of
// z^-1 (a^-1 b).
inline SE3::Tangent error(const SE3& z, const SE3& a, const SE3& b) {
  return detail::error_at(detail::position_in(a, b), detail::rotation_error(z, a, b), z,
                          z.q.conjugate());
}

// The error and its derivatives with respect to a * da and b * db at da = db = 0.
inline SE3::Tangent error(const SE3& z, const SE3& a, const SE3& b, SE3::Square& da,
                          SE3::Square& db) {
  const Eigen::Vector3d p = detail::position_in(a, b);
  const Eigen::Quaterniond r = detail::rotation_error(z, a, b);
  const Eigen::Matrix3d zt = z.q.conjugate().toRotationMatrix();
  const Eigen::Matrix3d cross = detail::cross_matrix(r.vec());
  const Eigen::Matrix3d w = r.w() * Eigen::Matrix3d::Identity();

  da.topLeftCorner<3, 3>() = -zt;
  da.topRightCorner<3, 3>().noalias() = 2 * zt * detail::cross_matrix(p);
  da.bottomLeftCorner<3, 3>().setZero();
  da.bottomRightCorner<3, 3>().noalias() = (cross - w) * zt;
  db.topLeftCorner<3, 3>() = r.toRotationMatrix();
  db.topRightCorner<3, 3>().setZero();
  db.bottomLeftCorner<3, 3>().setZero();
  db.bottomRightCorner<3, 3>() = w + cross;
  return detail::error_at(p, r, z, zt);
}

// The derivative of the step that a * o takes when a takes one, o^-1 da o, at da = 0.
inline SE3::Square step_at(const SE3& o) {
  const Eigen::Matrix3d back = o.q.conjugate().toRotationMatrix();
  SE3::Square m;
  m.topLeftCorner<3, 3>() = back;
  m.topRightCorner<3, 3>().noalias() = -2 * back * detail::cross_matrix(o.t);
  m.bottomLeftCorner<3, 3>().setZero();
  m.bottomRightCorner<3, 3>() = back;
  return m;
}

}  // namespace masat
