// The elimination tree of a symmetric matrix and the column counts of its Cholesky factor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sparse/block_pattern.hpp"

namespace masat {

struct EliminationTree {
  std::vector<std::int32_t> order;   // the node eliminated k-th: a postorder of the tree
  std::vector<std::int32_t> index;   // the inverse of `order`
  std::vector<std::int32_t> parent;  // by index; -1 at a root
  std::vector<std::int32_t> count;   // blocks in each column of the factor, with the diagonal one
};

// `order` may be any elimination order. It is replaced by the equivalent postorder.
EliminationTree find_elimination_tree(const BlockGraph& graph, std::span<const std::int32_t> order);

}  // namespace masat
