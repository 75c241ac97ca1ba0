// The positions of everything in a multifrontal factorization: the fronts in the factor, the blocks
// of the matrix in the fronts, and the children in their parents.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sparse/assembly_tree.hpp"
#include "sparse/block_pattern.hpp"
#include "sparse/forest.hpp"
#include "sparse/kernels.hpp"

namespace masat {

// A block of the matrix below or on the diagonal of the factor.
struct BlockEntry {
  std::int64_t target;  // index of its first scalar in the front
  std::int32_t source;  // index in the pattern
  bool below;           // in l21, else in l11
  bool transposed;
};

// Whole vectors. Long columns take an odd number of cache lines, so that the columns of a tile do
// not compete for the same sets of the cache.
inline std::int64_t leading_dimension(std::int64_t rows, int lanes) {
  const std::int64_t padded = (rows + lanes - 1) / lanes * lanes;
  return padded >= 64 && padded % 16 == 0 ? padded + 8 : padded;
}

class FrontLayout {
 public:
  FrontLayout(const BlockPattern& pattern, const BlockGraph& graph, const EliminationTree& tree,
              int block_size, int lanes);

  const AssemblyTree& tree() const { return tree_; }
  int block_size() const { return block_size_; }
  std::int32_t fronts() const { return tree_.fronts(); }
  const FrontShape& shape(std::int32_t f) const { return shape_[f]; }
  // Index of a front's first pivot in a vector in the elimination order.
  std::int64_t first(std::int32_t f) const { return std::int64_t{tree_.first[f]} * block_size_; }

  // Without the boundary, whose values become a contribution block.
  std::int64_t factor_size() const {
    return tree_.boundary > 0 ? factor_start_[fronts() - 1] : factor_start_.back();
  }
  std::int64_t boundary_size() const { return factor_start_.back() - factor_size(); }
  std::int64_t factor_start(std::int32_t f) const { return factor_start_[f]; }
  std::int64_t contribution_size(std::int32_t f) const { return shape_[f].ld21 * shape_[f].rows; }
  // A front of which `values` and `contribution` hold the values.
  Front front(std::int32_t f, double* values, double* contribution = nullptr) const {
    return {shape_[f], values, values + l11_size(f), contribution};
  }

  std::span<const std::int32_t> children(std::int32_t f) const { return children_.of(f); }
  // The positions of a front's rows in its parent.
  std::span<const Run> runs(std::int32_t f) const {
    return {runs_.data() + run_start_[f], runs_.data() + run_start_[f + 1]};
  }
  // The blocks of the matrix in the columns of an index in the elimination order.
  std::span<const BlockEntry> entries(std::int32_t index) const {
    return {entries_.data() + entry_start_[index], entries_.data() + entry_start_[index + 1]};
  }

 private:
  std::int64_t l11_size(std::int32_t f) const { return shape_[f].ld11 * shape_[f].pivots; }
  void lay_out_fronts(int lanes);
  void find_runs();
  void lay_out_entries(const BlockPattern& pattern, const BlockGraph& graph);

  int block_size_;
  AssemblyTree tree_;
  Children children_;
  std::vector<FrontShape> shape_;
  std::vector<std::int64_t> factor_start_, run_start_, entry_start_;
  std::vector<Run> runs_;
  std::vector<BlockEntry> entries_;
};

}  // namespace masat
