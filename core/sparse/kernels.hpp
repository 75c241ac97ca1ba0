// Dense kernels of a front, for the widest vectors of the machine at run time.
//
// A front is a dense symmetric matrix, lower triangle, column-major: `pivots` columns to eliminate,
// stored as the square `l11` above the rectangle `l21`, and the contribution block `cb` of the
// `rows` below. Each column begins at a multiple of `lanes` and is padded to a multiple of it.
#pragma once

#include <cstdint>

namespace masat {

// Consecutive rows of a child's contribution block that are also consecutive in its parent. Either
// all of them are pivots of the parent or none is.
struct Run {
  std::int32_t source, target, length;
};

struct FrontShape {
  std::int32_t pivots, rows;
  std::int64_t ld11, ld21;  // the contribution block's is ld21
};

struct Front : FrontShape {
  double* l11;
  double* l21;
  double* cb;
};

struct Kernels {
  // The number of columns that factor_diagonal and solve_rows process at once.
  static constexpr std::int32_t kPanel = 48;
  // The number of rows of a front in one task, a multiple of `lanes`.
  static constexpr std::int32_t kTile = 32;

  std::int32_t lanes;
  std::int32_t width;  // the number of right-hand sides in one wide solve

  // Factorizes the diagonal block of the panel of columns that begins at `begin`, after all panels
  // before it. Stores 1 / sqrt(pivot) in `reciprocal`. Returns -1, or the column whose pivot
  // failed: it is not greater than its floor.
  std::int32_t (*factor_diagonal)(const Front& front, std::int32_t begin, double* reciprocal,
                                  const double* floor);
  // Computes the panel's columns in the rows [first, last) of l11 or of l21; `first` is a multiple
  // of `lanes`.
  void (*solve_rows)(const Front& front, std::int32_t begin, const double* reciprocal, bool below,
                     std::int32_t first, std::int32_t last);
  // Sets cb = -l21 l21' in the rows [first, last).
  void (*update_rows)(const Front& front, std::int32_t first, std::int32_t last);
  // Adds a child's contribution block, in the front's columns [first, last). A packed block holds
  // its lower triangle alone, column by column without gaps; `ld_child` is one less than its rows.
  void (*extend_add)(const Front& front, const double* child, std::int64_t ld_child, bool packed,
                     const Run* runs, std::int64_t count, std::int32_t first, std::int32_t last);

  // Sets x = l11^-1 x and y = l21 x, for padded and aligned x and y.
  void (*forward)(const Front& front, const double* reciprocal, double* x, double* y);
  // Sets x = l11'^-1 (x - l21' y).
  void (*backward)(const Front& front, const double* reciprocal, double* x, const double* y);
  // The same for `width` right-hand sides, side by side in each row of x and y.
  void (*forward_wide)(const Front& front, const double* reciprocal, double* x, double* y);
  void (*backward_wide)(const Front& front, const double* reciprocal, double* x, const double* y);
};

// The kernels for this processor.
const Kernels& kernels();

}  // namespace masat
