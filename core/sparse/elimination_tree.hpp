// The elimination tree of a symmetric matrix and the column counts of its Cholesky factor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sparse/block_pattern.hpp"

namespace masat {

// What is eliminated elsewhere, if a matrix is that of a part of a graph.
struct Interface {
  // The last nodes of the order are not eliminated: other parts add to them.
  std::int32_t boundary = 0;
  // Each of the nodes with the greatest numbers stands for a contribution block that was computed
  // elsewhere, and is joined to the nodes of that block. It comes before them in the order.
  std::int32_t elements = 0;
};

struct EliminationTree {
  std::vector<std::int32_t> order;   // the node eliminated k-th: a postorder of the tree
  std::vector<std::int32_t> index;   // the inverse of `order`
  std::vector<std::int32_t> parent;  // by index; -1 at a root
  std::vector<std::int32_t> count;   // blocks in each column of the factor, with the diagonal one
  Interface interface;

  std::int32_t nodes() const { return static_cast<std::int32_t>(order.size()); }
  // The index of the first node that is not eliminated. The boundary is a chain: its nodes are all
  // joined to each other, and the first of them is above all other nodes.
  std::int32_t boundary() const { return nodes() - interface.boundary; }
  bool is_element(std::int32_t index) const { return order[index] >= nodes() - interface.elements; }
};

// `order` may be any elimination order. It is replaced by the equivalent postorder, in which the
// boundary comes last as before.
EliminationTree find_elimination_tree(const BlockGraph& graph, std::span<const std::int32_t> order,
                                      Interface interface = {});

}  // namespace masat
