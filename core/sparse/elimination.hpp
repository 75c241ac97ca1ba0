// How the linear systems of a graph are eliminated. It is found once and shared by all of them.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <vector>

#include "graph/topology.hpp"
#include "sparse/block_pattern.hpp"
#include "sparse/block_size.hpp"
#include "sparse/elimination_tree.hpp"
#include "sparse/front_layout.hpp"

namespace masat {

class Elimination {
 public:
  // The matrix has a block for each free node and each pair of free nodes that edges join; `fixed`
  // nodes are left out. `order[k]` is the free node to eliminate k-th, by its index among the free
  // ones; without an order that of minimum degree is used. Postordering replaces either by an
  // equivalent one. `interface` is by indices among the free nodes too.
  Elimination(const Topology& graph, std::span<const bool> fixed,
              std::span<const std::int32_t> order = {}, Interface interface = {});

  std::int32_t nodes() const { return static_cast<std::int32_t>(index_.size()); }
  std::int64_t edges() const { return static_cast<std::int64_t>(joint_.size()); }
  std::span<const std::int32_t> free_nodes() const { return free_; }
  // A node's index among the free ones, or -1.
  std::int32_t index(std::int32_t node) const { return index_[node]; }
  // The index in the pattern of the block of an edge's two nodes, or -1.
  std::int64_t joint(std::int64_t edge) const { return joint_[edge]; }

  const BlockPattern& pattern() const { return pattern_; }
  const BlockGraph& adjacency() const { return adjacency_; }
  const EliminationTree& tree() const { return tree_; }

  // Entries of the factor of a matrix of d x d blocks, and the floating-point operations to compute
  // it, both without the padding of the storage and without what is not eliminated.
  std::int64_t fill(int d) const;
  double operations(int d) const;

  // The fronts of the factor of d x d blocks, d from 1 to 10; computed at the first call.
  const FrontLayout& layout(int d) const;

 private:
  BlockPattern find_pattern(const Topology& graph);

  std::vector<std::int32_t> free_, index_;
  std::vector<std::int64_t> joint_;
  BlockPattern pattern_;
  BlockGraph adjacency_;
  EliminationTree tree_;
  mutable std::array<std::unique_ptr<FrontLayout>, kLargestBlock> layouts_;
  mutable std::mutex mutex_;
};

}  // namespace masat
