// Edges in groups whose parts of a matrix several threads can add at the same time.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "graph/topology.hpp"
#include "sparse/elimination.hpp"

namespace masat {

// Groups have about as many edges. Each owns the nodes of a range of the elimination order, whose
// neighbors are mostly in the same range. An edge belongs to the group of its end that is
// eliminated first, so no other group has the block of its two nodes. What a group adds to a node
// of another one goes to a cell, and from there to the node after all groups. The groups do not
// depend on the threads, so that sums always have the same order.
struct EdgeGroups {
  // Where an edge adds its parts.
  struct Entry {
    std::int32_t edge;
    std::int32_t from, to;       // of its nodes: index among the free ones, or kFixed, or a cell,
                                 // counted from the number of free nodes
    std::uint32_t joint : 30;    // block of the two nodes in the pattern
    std::uint32_t flipped : 1;   // whether its rows are those of `from`
    std::uint32_t repeated : 1;  // whether an earlier edge of the group has the same one
  };
  static constexpr std::int32_t kFixed = -1;

  // `work` is the number of scalars in a block: edges take time in proportion to it.
  EdgeGroups(const Elimination& elimination, std::span<const Edge> edges, int work);

  std::int32_t count() const { return static_cast<std::int32_t>(entry_start.size()) - 1; }
  std::span<const Entry> entries_of(std::int32_t group) const {
    return {entries.data() + entry_start[group], entries.data() + entry_start[group + 1]};
  }

  std::vector<std::int64_t> entry_start;
  std::vector<Entry> entries;
  // The node to which each cell belongs, by the groups of the nodes. The cells of a node are in the
  // order of the groups that add to them.
  std::vector<std::int64_t> cell_start;
  std::vector<std::int32_t> cell_node;
  // The block of each free node, and of each cell behind those of the pattern.
  std::vector<std::int32_t> block;
};

}  // namespace masat
