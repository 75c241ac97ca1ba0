// Sparse Cholesky of a symmetric matrix of d x d blocks: analyze once, factorize often, solve.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "sparse/elimination.hpp"

namespace masat {

class BlockCholesky {
 public:
  // Blocks have 1 to 10 rows. Results do not depend on the number of threads. The elimination must
  // outlive it.
  BlockCholesky(const Elimination& elimination, int block_size, int threads = 1);
  ~BlockCholesky();

  // Factorizes the matrix with the blocks `values`, each column-major, in the order of the
  // pattern, plus the diagonal `damping`. Every entry counts, zeros too: the pattern never
  // changes. Returns -1, or the block at which the matrix is not positive definite.
  std::int32_t factorize(std::span<const double> values, std::span<const double> damping);

  // Where the matrix is not positive definite: nodes that, with `held` instead of their damping,
  // let it be so, ascending.
  std::vector<std::int32_t> indefinite(std::span<const double> values, std::vector<double> damping,
                                       std::span<const double> held);

  // Overwrites the right-hand sides, the columns of a row-major matrix, with the solutions. One
  // thread at a time.
  void solve(std::span<double> rhs, int columns = 1) const;

  // Writes the blocks of the inverse at (rows[k], columns[k]), each row-major.
  void inverse(std::span<const std::int32_t> rows, std::span<const std::int32_t> columns,
               double* out) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace masat
