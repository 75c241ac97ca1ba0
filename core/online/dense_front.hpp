// The elimination of one front by one thread, and the addition of children in any order.
#pragma once

#include <algorithm>
#include <cstdint>

#include "sparse/kernels.hpp"

namespace masat {

// Factorizes the pivots of an assembled front. Returns -1, or the pivot that failed.
inline std::int32_t eliminate_pivots(const Kernels& kernels, const Front& front, double* reciprocal,
                                     const double* floor) {
  for (std::int32_t begin = 0; begin < front.pivots; begin += Kernels::kPanel) {
    const std::int32_t failed = kernels.factor_diagonal(front, begin, reciprocal, floor);
    if (failed >= 0) return failed;
    const std::int32_t end = std::min(begin + Kernels::kPanel, front.pivots);
    for (const bool below : {false, true}) {
      const std::int32_t last = below ? front.rows : front.pivots;
      for (std::int32_t first = below ? 0 : end; first < last; first += Kernels::kTile) {
        kernels.solve_rows(front, begin, reciprocal, below, first,
                           std::min(first + Kernels::kTile, last));
      }
    }
  }
  return -1;
}

// Sets the contribution block to minus the product of the rows.
inline void update_contribution(const Kernels& kernels, const Front& front) {
  for (std::int32_t first = 0; first < front.rows; first += Kernels::kTile) {
    kernels.update_rows(front, first, std::min(first + Kernels::kTile, front.rows));
  }
}

// Copies the lower triangle of the contribution block, column by column without gaps.
inline void pack_contribution(const Front& front, double* to) {
  for (std::int32_t c = 0; c < front.rows; ++c) {
    const double* const column = front.cb + c * front.ld21;
    for (std::int32_t r = c; r < front.rows; ++r) *to++ = column[r];
  }
}

inline std::int64_t packed_size(std::int64_t rows) { return rows * (rows + 1) / 2; }

// Adds a child's packed contribution block whose rows are in another order than those of the front.
// `target` are the blocks of the front in which its blocks lie: pivots, then rows. Adds to the
// columns of pivots, or to the others.
template <int kSize>
void add_child_in_any_order(const Front& front, const double* child, const std::int32_t* target,
                            std::int32_t blocks, bool to_pivots) {
  const std::int32_t pivots = front.pivots / kSize;
  const std::int64_t ld_child = std::int64_t{blocks} * kSize - 1;
  for (std::int32_t j = 0; j < blocks; ++j) {
    // Where row 0 of each column would be.
    const double* columns[kSize];
    for (int c = 0; c < kSize; ++c) {
      const std::int64_t column = std::int64_t{j} * kSize + c;
      columns[c] = child + column * ld_child - column * (column - 1) / 2;
    }
    for (std::int32_t i = j; i < blocks; ++i) {
      const std::int32_t row = std::max(target[i], target[j]);
      const std::int32_t column = std::min(target[i], target[j]);
      if ((column < pivots) != to_pivots) continue;
      const bool below = row >= pivots;
      const std::int64_t ld = below ? front.ld21 : front.ld11;
      double* const start = !to_pivots ? front.cb + std::int64_t{column - pivots} * kSize * ld
                            : below    ? front.l21 + std::int64_t{column} * kSize * ld
                                       : front.l11 + std::int64_t{column} * kSize * ld;
      double* const to = start + (below ? row - pivots : row) * kSize;
      if (i == j) {
        for (int c = 0; c < kSize; ++c) {
          for (int r = c; r < kSize; ++r) to[c * ld + r] += columns[c][i * kSize + r];
        }
      } else if (target[i] > target[j]) {
        for (int c = 0; c < kSize; ++c) {
          for (int r = 0; r < kSize; ++r) to[c * ld + r] += columns[c][i * kSize + r];
        }
      } else {
        for (int c = 0; c < kSize; ++c) {
          for (int r = 0; r < kSize; ++r) to[r * ld + c] += columns[c][i * kSize + r];
        }
      }
    }
  }
}

}  // namespace masat
