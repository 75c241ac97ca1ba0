// How long a front takes, by which supernodes are merged.
#pragma once

#include <cstdint>

namespace masat {

struct Supernode {
  std::int32_t pivots, rows;  // eliminated, and below them: in blocks
};

// Estimated nanoseconds to assemble and factorize a front.
inline double front_cost(Supernode front, int block_size) {
  const double pivots = double(front.pivots) * block_size, rows = double(front.rows) * block_size;
  const double products = pivots * (pivots * pivots / 6 + rows * (pivots + rows) / 2);
  return 100 + 0.1 * products + 0.2 * rows * rows + 0.5 * pivots * (pivots + rows);
}

}  // namespace masat
