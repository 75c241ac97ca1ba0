// A symmetric matrix with a block for each free node of a graph and each pair that edges join.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "sparse/block_cholesky.hpp"
#include "sparse/elimination.hpp"
#include "sparse/worker_pool.hpp"

namespace masat {

// Vectors and tables of right-hand sides have d rows a free node, and are row-major.
class GraphMatrix {
 public:
  // At most as many threads work as are asked for, and no more than find work. The numbers do not
  // depend on how many they are.
  GraphMatrix(std::shared_ptr<const Elimination> elimination, int block_size, int threads = 1);

  // A copy is not factorized.
  GraphMatrix(const GraphMatrix& other)
      : elimination_(other.elimination_),
        d_(other.d_),
        values_(other.values_),
        pool_(std::make_unique<WorkerPool>(other.pool_->threads())) {}
  GraphMatrix(GraphMatrix&&) = default;

  int block_size() const { return d_; }
  std::int64_t rows() const { return std::int64_t{d_} * pattern().columns(); }
  const std::shared_ptr<const Elimination>& elimination() const { return elimination_; }
  // The threads that compute with this matrix. One thread at a time may call any method, const
  // ones too: they share this pool.
  WorkerPool& pool() const { return *pool_; }

  // Adds to H the form
  //     x_from' first x_from + 2 x_from' joint x_to + x_to' second x_to
  // of an edge, its blocks row-major. Where one of its nodes is fixed, adds that node's part of the
  // right-hand side, -H x_fixed, to `rhs`. `values` has d rows for every node, `rhs` for every free
  // one.
  void add_edge(const Topology& graph, std::int64_t edge, const double* first, const double* joint,
                const double* second, const double* values, int columns, double* rhs);

  // Blocks behind those of the pattern, for parts of sums that are not part of the matrix.
  void set_cells(std::int64_t count) {
    values_.resize((static_cast<std::int64_t>(pattern().row.size()) + count) * d_ * d_);
  }
  void set_zero() { std::fill(values_.begin(), values_.end(), 0.0); }
  // Blocks, column-major: that of an entry of the pattern, that of a free node by its index, and
  // that of an edge between free nodes, whose rows are those of the node with the greater index.
  double* block(std::int64_t entry) { return values_.data() + entry * d_ * d_; }
  const double* block(std::int64_t entry) const { return values_.data() + entry * d_ * d_; }
  double* node_block(std::int32_t index) { return block(pattern().start[index]); }
  double* joint_block(std::int64_t edge) { return block(elimination_->joint(edge)); }

  void diagonal(double* out) const;
  // out = H v
  void multiply(const double* v, int columns, double* out) const;
  // Factorizes H plus a diagonal. Returns -1, or the index of the free node at which it is not
  // positive definite.
  [[nodiscard]] std::int32_t factorize(std::span<const double> damping,
                                       std::span<const Element> elements = {}) {
    return cholesky().factorize(values_, damping, elements);
  }
  // Indices of free nodes, ascending, that must be fixed for H plus the diagonal to be positive
  // definite: for each of them `fixing` replaces the damping.
  std::vector<std::int32_t> indefinite(std::vector<double> damping,
                                       std::span<const double> fixing) {
    return cholesky().indefinite(values_, std::move(damping), fixing);
  }

  // The rest needs a factorization that succeeded, and throws NotFactorized without one. Later
  // changes of the blocks do not affect it.
  bool factorized() const { return cholesky_ && cholesky_->factorized(); }
  // The smallest ratio of a pivot to its diagonal entry of H plus the damping; 1 without rows.
  double pivot_ratio() const { return factor().pivot_ratio(); }
  // Overwrites right-hand sides with the solutions.
  void solve(std::span<double> rhs, int columns = 1) const { factor().solve(rhs, columns); }
  // Of a part, see BlockCholesky.
  std::vector<double> contribution() const { return factor().contribution(); }
  void reduce(std::span<double> rhs) const { factor().reduce(rhs); }
  void substitute(std::span<double> rhs) const { factor().substitute(rhs); }
  // Writes blocks of the inverse, by indices among the free nodes, each row-major.
  void inverse(std::span<const std::int32_t> rows, std::span<const std::int32_t> columns,
               double* out) const {
    factor().inverse(rows, columns, out);
  }

  const BlockPattern& pattern() const { return elimination_->pattern(); }

 private:
  BlockCholesky& cholesky() {
    if (!cholesky_) cholesky_ = std::make_unique<BlockCholesky>(*elimination_, d_, *pool_);
    return *cholesky_;
  }
  const BlockCholesky& factor() const {
    if (!cholesky_) throw NotFactorized();
    return *cholesky_;
  }

  std::shared_ptr<const Elimination> elimination_;
  int d_;
  std::vector<double> values_;
  std::unique_ptr<WorkerPool> pool_;  // where it stays if the matrix moves
  std::unique_ptr<BlockCholesky> cholesky_;
};

}  // namespace masat
