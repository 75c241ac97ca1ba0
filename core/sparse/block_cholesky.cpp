#include "sparse/block_cholesky.hpp"

#include <Eigen/OrderingMethods>
#include <Eigen/SparseCholesky>
#include <cmath>
#include <limits>

namespace masat {
namespace {

using Sparse = Eigen::SparseMatrix<double>;
using Permutation = Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int>;

// Approximate minimum degree on the graph of the blocks, far smaller than that of the scalars.
Permutation order_blocks(const BlockPattern& pattern) {
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(2 * pattern.row.size());
  for (std::int32_t c = 0; c < pattern.columns(); ++c) {
    for (std::int64_t k = pattern.start[c]; k < pattern.start[c + 1]; ++k) {
      entries.emplace_back(pattern.row[k], c, 1.0);
      if (pattern.row[k] != c) entries.emplace_back(c, pattern.row[k], 1.0);
    }
  }
  Sparse graph(pattern.columns(), pattern.columns());
  graph.setFromTriplets(entries.begin(), entries.end());
  Permutation order;
  Eigen::AMDOrdering<int>()(graph, order);
  return order.inverse();  // block k of the matrix becomes block order[k] of the factor
}

}  // namespace

struct BlockCholesky::Impl {
  using Factor =
      Eigen::SimplicialLDLT<Sparse, Eigen::Lower, Eigen::NaturalOrdering<Sparse::StorageIndex>>;

  Impl(const BlockPattern& pattern, int block_size)
      : d(block_size), place(order_blocks(pattern)), origin(place.size()) {
    const std::int32_t n = pattern.columns();
    for (std::int32_t c = 0; c < n; ++c) origin[place.indices()[c]] = c;

    std::vector<Eigen::Triplet<double>> entries;
    entries.reserve(pattern.row.size() * d * d);
    for_each_scalar(pattern, [&](std::int64_t, int r, int c) { entries.emplace_back(r, c, 1.0); });
    lower.resize(n * d, n * d);
    lower.setFromTriplets(entries.begin(), entries.end());
    factor.analyzePattern(lower);

    target.resize(pattern.row.size() * d * d, -1);
    for_each_scalar(pattern, [&](std::int64_t k, int r, int c) {
      const int* const begin = lower.innerIndexPtr() + lower.outerIndexPtr()[c];
      const int* const end = lower.innerIndexPtr() + lower.outerIndexPtr()[c + 1];
      target[k] =
          static_cast<std::int32_t>(std::lower_bound(begin, end, r) - lower.innerIndexPtr());
    });
    work.resize(n * d);
  }

  // Visits each scalar of the lower triangle of the permuted matrix: (position in the block
  // values, row, column). The upper half of a diagonal block is passed over.
  template <class Visit>
  void for_each_scalar(const BlockPattern& pattern, Visit visit) const {
    for (std::int32_t c = 0; c < pattern.columns(); ++c) {
      for (std::int64_t k = pattern.start[c]; k < pattern.start[c + 1]; ++k) {
        const int row = place.indices()[pattern.row[k]] * d, column = place.indices()[c] * d;
        for (int j = 0; j < d; ++j) {
          for (int i = (row == column ? j : 0); i < d; ++i) {
            const std::int64_t source = (k * d + j) * d + i;
            if (row < column) {
              visit(source, column + j, row + i);
            } else {
              visit(source, row + i, column + j);
            }
          }
        }
      }
    }
  }

  int d;
  Permutation place;
  std::vector<std::int32_t> origin;  // the matrix's block of each block of the factor
  Sparse lower;
  std::vector<std::int32_t> target;  // where each block scalar goes in `lower`; -1: nowhere
  Factor factor;
  Eigen::VectorXd work;
};

BlockCholesky::BlockCholesky(const BlockPattern& pattern, int block_size)
    : impl_(std::make_unique<Impl>(pattern, block_size)) {}
BlockCholesky::~BlockCholesky() = default;

std::int32_t BlockCholesky::factorize(std::span<const double> values,
                                      std::span<const double> damping) {
  Impl& s = *impl_;
  double* const out = s.lower.valuePtr();
  for (std::size_t k = 0; k < values.size(); ++k) {
    if (s.target[k] >= 0) out[s.target[k]] = values[k];
  }
  // The diagonal comes first in each column of the lower triangle.
  const auto scalars = static_cast<int>(s.lower.cols());
  const int* const column = s.lower.outerIndexPtr();
  for (int k = 0; k < scalars; ++k) out[column[k]] += damping[s.origin[k / s.d] * s.d + k % s.d];
  s.factor.factorize(s.lower);
  // A pivot at the rounding level of its own diagonal is as good as zero.
  constexpr double epsilon = std::numeric_limits<double>::epsilon();
  const Eigen::VectorXd& pivots = s.factor.vectorD();
  for (int k = 0; k < scalars; ++k) {
    if (!(pivots[k] > epsilon * out[column[k]])) return s.origin[k / s.d];
  }
  return -1;
}

void BlockCholesky::solve(std::span<double> rhs) const {
  Impl& s = *impl_;
  const auto blocks = static_cast<std::int32_t>(s.origin.size());
  for (std::int32_t k = 0; k < blocks; ++k) {
    for (int i = 0; i < s.d; ++i) s.work[k * s.d + i] = rhs[s.origin[k] * s.d + i];
  }
  s.work = s.factor.solve(s.work).eval();
  for (std::int32_t k = 0; k < blocks; ++k) {
    for (int i = 0; i < s.d; ++i) rhs[s.origin[k] * s.d + i] = s.work[k * s.d + i];
  }
}

std::int64_t BlockCholesky::fill() const {
  return impl_->factor.matrixL().nestedExpression().nonZeros() + impl_->work.size();
}

}  // namespace masat
