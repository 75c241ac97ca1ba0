// The check of information matrices.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace masat {

// Indices of the matrices that are not positive definite.
template <int Dof>
std::vector<std::int64_t> not_positive_definite(const double* matrices, std::size_t count) {
  using Square = Eigen::Matrix<double, Dof, Dof>;
  std::vector<std::int64_t> bad;
  for (std::size_t k = 0; k < count; ++k) {
    const Eigen::LLT<Square> llt(Eigen::Map<const Square>(matrices + k * Dof * Dof));
    // Where elimination overflows, a pivot can be NaN, which Eigen does not report.
    const bool positive = (llt.matrixLLT().diagonal().array() > 0).all();
    if (llt.info() != Eigen::Success || !positive) bad.push_back(static_cast<std::int64_t>(k));
  }
  return bad;
}

}  // namespace masat
