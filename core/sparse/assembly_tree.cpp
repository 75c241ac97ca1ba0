#include "sparse/assembly_tree.hpp"

#include <algorithm>
#include <numeric>

#include "sparse/forest.hpp"
#include "sparse/supernodes.hpp"

namespace masat {
namespace {

// Sorts the nodes by front, those of a front in the order of the elimination tree.
void order_nodes(const EliminationTree& tree, std::span<const std::int32_t> front_of,
                 AssemblyTree& out) {
  const auto n = static_cast<std::int32_t>(front_of.size());
  out.first.assign(out.parent.size() + 1, 0);
  for (const std::int32_t f : front_of) ++out.first[f];
  std::partial_sum(out.first.begin(), out.first.end(), out.first.begin());
  out.order.resize(n);
  for (std::int32_t k = n - 1; k >= 0; --k) out.order[--out.first[front_of[k]]] = tree.order[k];
  out.index = invert(out.order);
}

// The rows of a front: those of its columns in the matrix and those of its children.
void find_rows(const BlockGraph& graph, AssemblyTree& out) {
  const Children children(out.parent);
  std::vector<std::int32_t> seen(out.order.size(), -1);
  out.row_start.assign(1, 0);
  for (std::int32_t f = 0; f < out.fronts(); ++f) {
    const std::int32_t end = out.first[f + 1];
    const auto begin = static_cast<std::int64_t>(out.row.size());
    const auto add = [&](std::int32_t row) {
      if (row < end || seen[row] == f) return;
      seen[row] = f;
      out.row.push_back(row);
    };
    for (std::int32_t k = out.first[f]; k < end; ++k) {
      for (const BlockGraph::Neighbor& i : graph.neighbors(out.order[k])) add(out.index[i.node]);
    }
    for (const std::int32_t c : children.of(f)) {
      for (std::int64_t k = out.row_start[c]; k < out.row_start[c + 1]; ++k) add(out.row[k]);
    }
    std::sort(out.row.begin() + begin, out.row.end());
    out.row_start.push_back(static_cast<std::int64_t>(out.row.size()));
  }
}

}  // namespace

AssemblyTree build_assembly_tree(const BlockGraph& graph, const EliminationTree& tree,
                                 int block_size) {
  const SupernodePartition supernodes = find_supernodes(tree, block_size);
  const std::vector<std::int32_t> post = postorder(supernodes.parent), front = invert(post);
  AssemblyTree out;
  for (const std::int32_t s : post) {
    const std::int32_t p = supernodes.parent[s];
    out.parent.push_back(p < 0 ? -1 : front[p]);
  }
  std::vector<std::int32_t> front_of(supernodes.of_node.size());
  for (std::size_t k = 0; k < front_of.size(); ++k) front_of[k] = front[supernodes.of_node[k]];
  order_nodes(tree, front_of, out);
  find_rows(graph, out);
  out.boundary = tree.interface.boundary;
  const std::int32_t first_element = tree.nodes() - tree.interface.elements;
  for (std::int32_t f = 0; f < out.fronts(); ++f) {
    out.element.push_back(std::max(out.order[out.first[f]] - first_element, -1));
  }
  return out;
}

}  // namespace masat
