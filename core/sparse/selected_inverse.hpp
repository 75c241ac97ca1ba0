// Chosen blocks of the inverse of a factorized matrix.
// Erisman, Tinney, "On computing certain elements of the inverse of a sparse matrix", CACM 1975;
// Kaess, Dellaert, "Covariance recovery from a square root information matrix for data
// association", Robotics and Autonomous Systems 2009.
#pragma once

#include <cstdint>
#include <span>

#include "sparse/front_layout.hpp"
#include "sparse/multifrontal.hpp"

namespace masat {

// Writes the block at (rows[k], columns[k]), row-major, for each k. Blocks in the pattern of the
// factor come from the recursion over the fronts that contain them and the ancestors of these.
// Other blocks come from solves with the columns of one node, restricted to the paths from both
// nodes to the root.
void invert_blocks(const FrontLayout& layout, const Multifrontal& factor,
                   std::span<const std::int32_t> rows, std::span<const std::int32_t> columns,
                   double* out);

}  // namespace masat
