// Sparse Cholesky of a symmetric matrix of d x d blocks: analyse once, factorise often, solve.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

namespace masat {

// Lower triangle by block columns, rows ascending, the diagonal block first in each.
struct BlockPattern {
  std::vector<std::int64_t> start;  // of each block column, and the end
  std::vector<std::int32_t> row;

  std::int32_t columns() const { return static_cast<std::int32_t>(start.size()) - 1; }
};

class BlockCholesky {
 public:
  // Analyses the pattern: a fill-reducing order of the blocks and the pattern of the factor.
  BlockCholesky(const BlockPattern& pattern, int block_size);
  ~BlockCholesky();

  // Factorises the matrix with the blocks `values`, each column-major, in the order of the
  // pattern, plus the diagonal `damping`. Every entry counts, zeros too: the pattern never
  // changes. Returns -1, or the block at which the matrix is not positive definite.
  std::int32_t factorize(std::span<const double> values, std::span<const double> damping);

  // Overwrites the right-hand side with the solution.
  void solve(std::span<double> rhs) const;

  // Entries of the factor.
  std::int64_t fill() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace masat
