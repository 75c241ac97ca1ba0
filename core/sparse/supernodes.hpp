// Supernodes: columns of the factor that are stored and eliminated together.
#pragma once

#include <cstdint>
#include <vector>

#include "sparse/elimination_tree.hpp"

namespace masat {

struct SupernodePartition {
  std::vector<std::int32_t> of_node;  // by index in the elimination tree
  std::vector<std::int32_t> parent;   // greater than the child; -1 at a root
};

// Fundamental supernodes, merged with their parents where by the estimated time the additional
// zeros cost less than the assembly that the merge saves.
SupernodePartition find_supernodes(const EliminationTree& tree, int block_size);

}  // namespace masat
