#include "sparse/elimination_tree.hpp"

#include <algorithm>
#include <utility>

#include "sparse/forest.hpp"

namespace masat {
namespace {

// Liu, "A compact row storage scheme for Cholesky factors using elimination trees", TOMS 1986.
std::vector<std::int32_t> find_parents(const BlockGraph& graph, std::span<const std::int32_t> order,
                                       std::span<const std::int32_t> index) {
  const std::int32_t n = graph.nodes();
  std::vector<std::int32_t> parent(n, -1), ancestor(n, -1);
  for (std::int32_t k = 0; k < n; ++k) {
    for (const BlockGraph::Neighbor& neighbor : graph.neighbors(order[k])) {
      std::int32_t i = index[neighbor.node];
      if (i > k) continue;
      while (ancestor[i] >= 0 && ancestor[i] != k) i = std::exchange(ancestor[i], k);
      if (ancestor[i] < 0) ancestor[i] = parent[i] = k;
    }
  }
  return parent;
}

// Gilbert, Ng, Peyton, "An efficient algorithm to compute row and column counts for sparse
// Cholesky factorization", SIMAX 1994. The tree is postordered.
std::vector<std::int32_t> count_columns(const BlockGraph& graph, const EliminationTree& tree) {
  const std::int32_t n = graph.nodes();
  std::vector<std::int32_t> first(n), count(n), ancestor(n);  // first: of the subtree
  std::vector<std::int32_t> last_first(n, -1), last_leaf(n, -1);
  for (std::int32_t k = 0; k < n; ++k) first[k] = ancestor[k] = k;
  for (std::int32_t k = 0; k < n; ++k) {
    count[k] += first[k] == k;
    const std::int32_t parent = tree.parent[k];
    if (parent >= 0) {
      first[parent] = std::min(first[parent], first[k]);
      --count[parent];
    }
    for (const BlockGraph::Neighbor& neighbor : graph.neighbors(tree.order[k])) {
      const std::int32_t row = tree.index[neighbor.node];
      if (row < k || first[k] <= last_first[row]) continue;
      // A leaf of the row's subtree. Its path to the root joins that of the leaf before at
      // `meeting`.
      last_first[row] = first[k];
      ++count[k];
      std::int32_t meeting = std::exchange(last_leaf[row], k);
      if (meeting < 0) continue;
      while (ancestor[meeting] != meeting) {
        ancestor[meeting] = ancestor[ancestor[meeting]];
        meeting = ancestor[meeting];
      }
      --count[meeting];
    }
    if (parent >= 0) ancestor[k] = parent;
  }
  for (std::int32_t k = 0; k < n; ++k) {
    if (tree.parent[k] >= 0) count[tree.parent[k]] += count[k];
  }
  return count;
}

// Makes the boundary, which begins at `first`, a chain above all other nodes.
void join_boundary(std::vector<std::int32_t>& parent, std::int32_t first) {
  const auto n = static_cast<std::int32_t>(parent.size());
  for (std::int32_t k = 0; k < first; ++k) {
    if (parent[k] < 0 || parent[k] > first) parent[k] = first;
  }
  for (std::int32_t k = first; k < n; ++k) parent[k] = k + 1 < n ? k + 1 : -1;
}

}  // namespace

EliminationTree find_elimination_tree(const BlockGraph& graph, std::span<const std::int32_t> order,
                                      Interface interface) {
  const std::int32_t n = graph.nodes();
  EliminationTree tree;
  tree.index = invert(order);
  tree.interface = interface;
  std::vector<std::int32_t> parent = find_parents(graph, order, tree.index);
  if (interface.boundary > 0) join_boundary(parent, n - interface.boundary);
  const std::vector<std::int32_t> post = postorder(parent);
  const std::vector<std::int32_t> renumbered = invert(post);
  tree.order.resize(n);
  tree.parent.resize(n);
  for (std::int32_t k = 0; k < n; ++k) {
    tree.order[k] = order[post[k]];
    tree.index[tree.order[k]] = k;
    tree.parent[k] = parent[post[k]] < 0 ? -1 : renumbered[parent[post[k]]];
  }
  tree.count = count_columns(graph, tree);
  for (std::int32_t k = n - interface.boundary; k < n; ++k) tree.count[k] = n - k;
  return tree;
}

}  // namespace masat
