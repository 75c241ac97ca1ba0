#include "sparse/supernodes.hpp"

#include <algorithm>

#include "sparse/forest.hpp"
#include "sparse/front_cost.hpp"

namespace masat {
namespace {

// Runs of only children with the same pattern below.
std::vector<Supernode> find_fundamental(const EliminationTree& tree,
                                        SupernodePartition& partition) {
  const auto n = static_cast<std::int32_t>(tree.parent.size());
  std::vector<std::int32_t> children(n, 0);
  for (const std::int32_t parent : tree.parent) {
    if (parent >= 0) ++children[parent];
  }
  std::vector<Supernode> supernodes;
  partition.of_node.resize(n);
  for (std::int32_t k = 0; k < n; ++k) {
    const bool continues = k > 0 && tree.parent[k - 1] == k && children[k] == 1 &&
                           tree.count[k - 1] == tree.count[k] + 1 && !tree.is_element(k - 1) &&
                           k != tree.boundary();
    if (!continues) supernodes.push_back({0, 0});
    ++supernodes.back().pivots;
    supernodes.back().rows = tree.count[k] - 1;
    partition.of_node[k] = static_cast<std::int32_t>(supernodes.size()) - 1;
  }
  partition.parent.assign(supernodes.size(), -1);
  for (std::int32_t k = 0; k < n; ++k) {
    if (k + 1 < n && partition.of_node[k + 1] == partition.of_node[k]) continue;
    if (tree.parent[k] < 0) continue;
    partition.parent[partition.of_node[k]] = partition.of_node[tree.parent[k]];
  }
  return supernodes;
}

// Greedy, from the leaves up. Returns the supernode into which each one is merged in the end.
std::vector<std::int32_t> amalgamate(std::vector<Supernode>& supernodes,
                                     std::span<const std::int32_t> parent,
                                     const std::vector<bool>& apart, int block_size) {
  const auto n = static_cast<std::int32_t>(supernodes.size());
  const Children children(parent);
  std::vector<std::int32_t> merged_into(n), by_rows;
  for (std::int32_t p = 0; p < n; ++p) {
    merged_into[p] = p;
    if (apart[p]) continue;
    by_rows.assign(children.of(p).begin(), children.of(p).end());
    std::stable_sort(by_rows.begin(), by_rows.end(), [&](std::int32_t a, std::int32_t b) {
      return supernodes[a].rows > supernodes[b].rows;
    });
    for (const std::int32_t c : by_rows) {
      if (apart[c]) continue;
      const Supernode merged{supernodes[p].pivots + supernodes[c].pivots, supernodes[p].rows};
      if (front_cost(merged, block_size) <=
          front_cost(supernodes[p], block_size) + front_cost(supernodes[c], block_size)) {
        supernodes[p] = merged;
        merged_into[c] = p;
      }
    }
  }
  for (std::int32_t s = n - 1; s >= 0; --s) merged_into[s] = merged_into[merged_into[s]];
  return merged_into;
}

}  // namespace

SupernodePartition find_supernodes(const EliminationTree& tree, int block_size) {
  SupernodePartition fundamental;
  std::vector<Supernode> supernodes = find_fundamental(tree, fundamental);
  // Elements and the boundary are not eliminated.
  std::vector<bool> apart(supernodes.size(), false);
  for (std::int32_t k = 0; k < tree.nodes(); ++k) {
    if (tree.is_element(k) || k >= tree.boundary()) apart[fundamental.of_node[k]] = true;
  }
  const std::vector<std::int32_t> merged_into =
      amalgamate(supernodes, fundamental.parent, apart, block_size);

  std::vector<std::int32_t> number(merged_into.size());
  SupernodePartition merged;
  std::int32_t kept = 0;
  for (std::size_t s = 0; s < merged_into.size(); ++s) {
    if (merged_into[s] == static_cast<std::int32_t>(s)) number[s] = kept++;
  }
  merged.parent.assign(kept, -1);
  for (std::size_t s = 0; s < merged_into.size(); ++s) {
    if (merged_into[s] != static_cast<std::int32_t>(s) || fundamental.parent[s] < 0) continue;
    merged.parent[number[s]] = number[merged_into[fundamental.parent[s]]];
  }
  merged.of_node.resize(fundamental.of_node.size());
  for (std::size_t k = 0; k < merged.of_node.size(); ++k) {
    merged.of_node[k] = number[merged_into[fundamental.of_node[k]]];
  }
  return merged;
}

}  // namespace masat
