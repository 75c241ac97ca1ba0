// Dense kernels of a front, for the widest vectors of the machine at run time.
//
// A front is a dense symmetric matrix, lower triangle, column-major: `pivots` columns to eliminate,
// stored as the square `l11` above the rectangle `l21`, and the contribution block `cb` of the
// `rows` below. Columns begin at multiples of `lanes` and are padded to them.
#pragma once

#include <cstdint>

namespace masat {

// Consecutive rows of a child's contribution block that are consecutive in its parent, either all
// pivots or none.
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
  // Columns that factor_diagonal and solve_rows take at once.
  static constexpr std::int32_t kPanel = 48;
  // Rows of a front that make one task, a multiple of the lanes.
  static constexpr std::int32_t kTile = 32;

  std::int32_t lanes;
  std::int32_t width;  // right-hand sides that the wide solves take at once

  // Factorizes the diagonal block of the panel of columns that begins at `begin`, all panels before
  // being done. Keeps the pivots' reciprocals. Returns -1, or the column whose pivot is not greater
  // than its floor.
  std::int32_t (*factor_diagonal)(const Front& front, std::int32_t begin, double* reciprocal,
                                  const double* floor);
  // The panel's columns in the rows [first, last) of l11 or of l21, first a multiple of the lanes.
  void (*solve_rows)(const Front& front, std::int32_t begin, const double* reciprocal, bool below,
                     std::int32_t first, std::int32_t last);
  // cb = -l21 l21' in the rows [first, last).
  void (*update_rows)(const Front& front, std::int32_t first, std::int32_t last);
  // Adds a child's contribution block, in the front's columns [first, last).
  void (*extend_add)(const Front& front, const double* child, std::int64_t ld_child,
                     const Run* runs, std::int64_t count, std::int32_t first, std::int32_t last);

  // x = l11^-1 x and y = l21 x, for padded and aligned x and y.
  void (*forward)(const Front& front, const double* reciprocal, double* x, double* y);
  // x = l11'^-1 (x - l21' y).
  void (*backward)(const Front& front, const double* reciprocal, double* x, const double* y);
  // The same for `width` right-hand sides, side by side in each row of x and y.
  void (*forward_wide)(const Front& front, const double* reciprocal, double* x, double* y);
  void (*backward_wide)(const Front& front, const double* reciprocal, double* x, const double* y);
};

const Kernels& kernels();

}  // namespace masat
