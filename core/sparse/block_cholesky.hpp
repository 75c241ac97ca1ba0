// Sparse Cholesky of a symmetric matrix of d x d blocks: analyze once, factorize often, solve.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <stdexcept>
#include <vector>

#include "sparse/elimination.hpp"
#include "sparse/multifrontal.hpp"
#include "sparse/worker_pool.hpp"

namespace masat {

// Thrown by solve and inverse.
struct NotFactorized : std::logic_error {
  NotFactorized()
      : logic_error(
            "the matrix is not factorized: call factorize() before solve() or inverse(), and check "
            "that it returned -1") {}
};

// Thrown by solve and inverse of a matrix with a boundary.
struct PartOnly : std::logic_error {
  PartOnly()
      : logic_error(
            "the matrix has a boundary, of which other parts know more: call reduce() and "
            "substitute()") {}
};

class BlockCholesky {
 public:
  // Blocks have 1 to 10 rows. Results do not depend on the number of threads. The elimination and
  // the pool must outlive this object.
  BlockCholesky(const Elimination& elimination, int block_size, WorkerPool& pool);
  ~BlockCholesky();

  // Factorizes the matrix with the blocks `values`, each column-major, in the order of the pattern,
  // plus the diagonal `damping`. Zeros are entries like others: the pattern never changes. Returns
  // -1, or the block at which the matrix is not positive definite. An exception, such as that of an
  // interrupt, leaves no factorization.
  // `elements` are the contribution blocks that the elements of the elimination stand for.
  [[nodiscard]] std::int32_t factorize(std::span<const double> values,
                                       std::span<const double> damping,
                                       std::span<const Element> elements = {});

  // Nodes, ascending, at which the matrix is not positive definite: with `fixing` instead of their
  // damping it becomes so. Leaves no factorization.
  std::vector<std::int32_t> indefinite(std::span<const double> values, std::vector<double> damping,
                                       std::span<const double> fixing);

  // Whether the last factorization succeeded.
  bool factorized() const;

  // The smallest ratio of a pivot to its diagonal entry before the elimination, damping included;
  // 1 without rows. An estimate of the reciprocal condition number of the scaled matrix.
  double pivot_ratio() const;

  // Overwrites the right-hand sides, the columns of a row-major matrix, with the solutions. Only
  // one thread may call this at a time.
  void solve(std::span<double> rhs, int columns = 1) const;

  // Of a matrix with a boundary, instead: its Schur complement as the lower triangle, packed column
  // by column in the order of the boundary; and the two halves of a solution of one right-hand
  // side, between which that of the boundary is put in. Parts share workspace: the first must be
  // asked for before this thread factorizes another part, or OverwrittenByOther is thrown.
  std::vector<double> contribution() const;
  void reduce(std::span<double> rhs) const;
  void substitute(std::span<double> rhs) const;

  // Writes the blocks of the inverse at (rows[k], columns[k]), each row-major.
  void inverse(std::span<const std::int32_t> rows, std::span<const std::int32_t> columns,
               double* out) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace masat
