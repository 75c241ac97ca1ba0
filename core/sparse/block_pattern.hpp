// The pattern of a symmetric matrix of blocks, and its graph.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace masat {

// Lower triangle by block columns, rows ascending, the diagonal block first in each.
struct BlockPattern {
  std::vector<std::int64_t> start;  // of each block column, and the end
  std::vector<std::int32_t> row;

  std::int32_t columns() const { return static_cast<std::int32_t>(start.size()) - 1; }
};

// The off-diagonal blocks of both triangles, by columns.
class BlockGraph {
 public:
  struct Neighbor {
    std::int32_t node;
    std::int32_t entry;  // index of the block in the pattern
  };

  explicit BlockGraph(const BlockPattern& pattern);

  std::int32_t nodes() const { return static_cast<std::int32_t>(start_.size()) - 1; }
  std::span<const Neighbor> neighbors(std::int32_t node) const {
    return {neighbor_.data() + start_[node], neighbor_.data() + start_[node + 1]};
  }

 private:
  std::vector<std::int64_t> start_;
  std::vector<Neighbor> neighbor_;
};

}  // namespace masat
