// The lifted chordal problem of a pose graph: rotations as frames of any rank.
//
// A free node's unknown is X, four rows of P numbers: those of its frame, then those of its
// translation. In 3D X = [R t]', the frame three orthonormal rows and the translation one; in 2D,
// where a rotation is a complex number of unit length and so is what a translation has for its two
// coordinates, real and imaginary parts have a row each. With P = 3 in 3D and P = 1 in 2D this is
// the chordal problem itself; local minima vanish as P grows. The cost is
// <X, M X> - 2 <X, F> + constant: M over the free nodes, F the right-hand side from the fixed ones.
// Sources: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; in 2D Carlone, Calafiore,
// Tommolillo, Dellaert, Planar pose graph optimization, IEEE T-RO 2016, and Fan, Wang, Rubenstein,
// Murphey, CPL-SLAM, IEEE T-RO 2020. Here the translations stay among the unknowns.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <type_traits>
#include <vector>

#include "relaxation/frames.hpp"
#include "relaxation/pose_form.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

// Unknowns and residuals are flat arrays, row by row, of the free nodes.
template <int D, int P>
class Lifted {
 public:
  using Frames = std::conditional_t<D == 2, ComplexUnit<P>, Stiefel<3, P>>;
  using Frame = typename Frames::Frame;
  using Square = typename Frames::Square;
  // Rows of a node's unknown, its numbers, those of its translation, and the coordinates of its
  // tangent space. The frame has D rows.
  static constexpr int kRows = kLiftedRows, kSize = kRows * P, kShifts = (kRows - D) * P,
                       kDof = Frames::kDof + kShifts;

  // The matrix and the linear term F must outlive it.
  Lifted(const GraphMatrix& matrix, const double* linear_term, double constant)
      : matrix_(matrix),
        linear_term_(linear_term),
        constant_(constant),
        nodes_(matrix.pattern().columns()) {}

  const GraphMatrix& matrix() const { return matrix_; }
  const double* linear_term() const { return linear_term_; }
  std::int32_t nodes() const { return nodes_; }

  static Eigen::Map<const Frame> frame(const std::vector<double>& x, std::int32_t k) {
    return Eigen::Map<const Frame>(&x[std::int64_t{k} * kSize]);
  }

  // Sets the residual M x - F, and returns the cost.
  double evaluate(const std::vector<double>& x, std::vector<double>& residual) const {
    residual.resize(x.size());
    matrix_.multiply(x.data(), P, residual.data());
    double cost = constant_;
    for (std::size_t i = 0; i < x.size(); ++i) {
      cost += x[i] * (residual[i] - 2 * linear_term_[i]);
      residual[i] -= linear_term_[i];
    }
    return cost;
  }

  // The Lagrange multiplier of the constraint on node k's frame.
  static Square multiplier(const std::vector<double>& x, const std::vector<double>& residual,
                           std::int32_t k) {
    return Frames::multiplier(frame(residual, k), frame(x, k));
  }

  // A node whose numbers are not all finite, for a cost that is not.
  std::int32_t node_not_finite(const std::vector<double>& x) const {
    const auto finite = [](const double* values, int count) {
      return std::all_of(values, values + count, [](double v) { return std::isfinite(v); });
    };
    for (std::int32_t k = 0; k < nodes_; ++k) {
      const std::int64_t at = std::int64_t{k} * kSize;
      const double* const block = matrix_.block(matrix_.pattern().start[k]);
      if (!finite(&x[at], kSize) || !finite(linear_term_ + at, kSize) ||
          !finite(block, kRows * kRows)) {
        return k;
      }
    }
    return 0;  // their products overflow
  }

 private:
  const GraphMatrix& matrix_;
  const double* linear_term_;
  double constant_;
  std::int32_t nodes_;
};

}  // namespace masat
