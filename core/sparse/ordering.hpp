// Fill-reducing orders of the blocks.
#pragma once

#include <cstdint>
#include <vector>

#include "sparse/block_pattern.hpp"

namespace masat {

// Approximate minimum degree: the node to eliminate k-th.
std::vector<std::int32_t> minimum_degree(const BlockGraph& graph);

}  // namespace masat
