// The frame of a node's lifted pose, and orthonormal coordinates of its tangent space.
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace masat {

// A matrix that is stored row by row: a column is so in either order, and has to be column-major.
template <int Rows, int Columns>
using RowByRow =
    Eigen::Matrix<double, Rows, Columns, Columns == 1 ? Eigen::ColMajor : Eigen::RowMajor>;

// A frame is D orthonormal rows of P numbers; its tangent space has kDof dimensions, and it is
// kUnits vectors of unit length.
template <int D, int P>
struct Stiefel {
  static constexpr int kTurns = D * (D - 1) / 2, kDof = kTurns + D * (P - D), kUnits = D;
  using Frame = RowByRow<D, P>;
  using Square = Eigen::Matrix<double, D, D>;
  // Each column is a change of the frame, row by row.
  using Basis = Eigen::Matrix<double, D * P, kDof>;

  // The Lagrange multiplier of the constraint on a frame y, for a gradient there.
  static Square multiplier(const Frame& gradient, const Frame& y) {
    const Square product = gradient * y.transpose();
    return (product + product.transpose()) / 2;
  }

  // Orthonormal: turns among the rows, and turns of each row out of their span.
  static Basis basis(const Frame& y) {
    Basis out = Basis::Zero();
    int column = 0;
    for (int i = 0; i < D; ++i) {
      for (int j = 0; j < i; ++j, ++column) {
        out.col(column).template segment<P>(i * P) = y.row(j).transpose() / std::sqrt(2.0);
        out.col(column).template segment<P>(j * P) = -y.row(i).transpose() / std::sqrt(2.0);
      }
    }
    Eigen::Matrix<double, P, P> full;  // columns: the rows, then their complement
    full.template leftCols<D>() = y.transpose();
    for (int k = D; k < P; ++k) {
      // Start from the unit vector that is farthest from the span so far.
      Eigen::Index farthest = 0;
      full.leftCols(k).rowwise().squaredNorm().minCoeff(&farthest);
      Eigen::Matrix<double, P, 1> v = Eigen::Matrix<double, P, 1>::Unit(farthest);
      for (int twice = 0; twice < 2; ++twice) {
        v -= full.leftCols(k) * (full.leftCols(k).transpose() * v);
      }
      full.col(k) = v.normalized();
      for (int i = 0; i < D; ++i, ++column) {
        out.col(column).template segment<P>(i * P) = full.col(k);
      }
    }
    return out;
  }

  // By the method of Gram and Schmidt.
  static Frame orthonormal(Frame y) {
    for (int i = 0; i < D; ++i) {
      for (int j = 0; j < i; ++j) y.row(i) -= y.row(i).dot(y.row(j)) * y.row(j);
      y.row(i).normalize();
    }
    return y;
  }
};

// A frame is P complex numbers whose squared lengths sum to one: a row of real parts and a row of
// imaginary ones.
template <int P>
struct ComplexUnit {
  using Flat = Stiefel<1, 2 * P>;
  static constexpr int kDof = Flat::kDof, kUnits = 1;
  using Frame = RowByRow<2, P>;
  using Square = Eigen::Matrix2d;
  using Basis = typename Flat::Basis;

  static Square multiplier(const Frame& gradient, const Frame& y) {
    return gradient.cwiseProduct(y).sum() * Square::Identity();
  }
  static Basis basis(const Frame& y) { return Flat::basis(flat(y)); }
  static Frame orthonormal(const Frame& y) { return y / y.norm(); }

 private:
  static Eigen::Map<const typename Flat::Frame> flat(const Frame& y) {
    return Eigen::Map<const typename Flat::Frame>(y.data());
  }
};

}  // namespace masat
