// Elimination of a front's pivots: left-looking inside a panel, panel by panel.
#pragma once

#include "sparse/kernels.hpp"
#include "sparse/kernels_vector.hpp"

namespace masat {
namespace {

template <int R, int N, bool kOverwrite>
void subtract_tile(double* c, std::int64_t ldc, const double* a, std::int64_t lda, const double* b,
                   std::int64_t ldb, std::int64_t depth) {
  Vector sum[N][R];
  multiply_tile<R, N>(a, lda, b, ldb, depth, sum);
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) {
#pragma GCC unroll 8
    for (int r = 0; r < R; ++r) {
      double* const out = c + n * ldc + r * kLanes;
      store(out, kOverwrite ? -sum[n][r] : load(out) - sum[n][r]);
    }
  }
}

// c -= a b' below the diagonal, which row 0 meets in column `diagonal`; whole vectors of rows.
template <bool kOverwrite>
void subtract_product(double* c, std::int64_t ldc, const double* a, std::int64_t lda,
                      const double* b, std::int64_t ldb, std::int64_t rows, std::int64_t columns,
                      std::int64_t depth, std::int64_t diagonal) {
  for (std::int64_t i = 0; i < rows; i += kVectors * kLanes) {
    const std::int64_t end = i + kVectors * kLanes < rows ? i + kVectors * kLanes : rows;
    for (std::int64_t j = 0; j < columns; j += kColumns) {
      const std::int64_t on_diagonal = round_down(j - diagonal);
      const std::int64_t first = on_diagonal > i ? on_diagonal : i;
      if (first >= end) break;
      with_tile((end - first) / kLanes, columns - j, [&]<int R, int N>() {
        subtract_tile<R, N, kOverwrite>(c + j * ldc + first, ldc, a + first, lda, b + j, ldb,
                                        depth);
      });
    }
  }
}

// c = (c - a b') l'^-1 with the lower triangle l of N columns.
template <int R, int N>
void solve_tile(double* c, std::int64_t ldc, const double* a, std::int64_t lda, const double* b,
                std::int64_t ldb, std::int64_t depth, const double* l, std::int64_t ldl,
                const double* reciprocal) {
  Vector x[N][R];
  multiply_tile<R, N>(a, lda, b, ldb, depth, x);
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) {
#pragma GCC unroll 8
    for (int r = 0; r < R; ++r) x[n][r] = load(c + n * ldc + r * kLanes) - x[n][r];
  }
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) {
#pragma GCC unroll 8
    for (int k = 0; k < n; ++k) {
      const Vector factor = Vector{} + l[k * ldl + n];
#pragma GCC unroll 8
      for (int r = 0; r < R; ++r) x[n][r] -= x[k][r] * factor;
    }
    const Vector factor = Vector{} + reciprocal[n];
#pragma GCC unroll 8
    for (int r = 0; r < R; ++r) {
      x[n][r] *= factor;
      store(c + n * ldc + r * kLanes, x[n][r]);
    }
  }
}

template <int N>
int factor_block(double* a, std::int64_t ld, double* reciprocal, const double* floor) {
  double l[N][N];
  for (int j = 0; j < N; ++j) {
    for (int i = j; i < N; ++i) l[j][i] = a[j * ld + i];
  }
#pragma GCC unroll 8
  for (int j = 0; j < N; ++j) {
    if (!(l[j][j] > floor[j])) return j;
    const double root = __builtin_sqrt(l[j][j]), inverse = 1 / root;
    reciprocal[j] = inverse;
    l[j][j] = root;
#pragma GCC unroll 8
    for (int i = j + 1; i < N; ++i) l[j][i] *= inverse;
#pragma GCC unroll 8
    for (int k = j + 1; k < N; ++k) {
#pragma GCC unroll 8
      for (int i = k; i < N; ++i) l[k][i] -= l[j][i] * l[j][k];
    }
  }
  for (int j = 0; j < N; ++j) {
    for (int i = j; i < N; ++i) a[j * ld + i] = l[j][i];
  }
  return -1;
}

// One block of N columns at `j` in the diagonal block of a panel that begins at `begin`.
template <int N>
[[gnu::noinline]] int factor_columns(const Front& front, std::int32_t begin, std::int32_t end,
                                     std::int32_t j, double* reciprocal, const double* floor) {
  const std::int64_t ld = front.ld11, depth = j - begin;
  const std::int32_t top = round_down(j), bottom = round_up(j + N);
  double* const column = front.l11 + j * ld;
  const double* const left = front.l11 + begin * ld;
  for (std::int32_t i = top; i < bottom; i += kLanes) {
    subtract_tile<1, N, false>(column + i, ld, left + i, ld, left + j, ld, depth);
  }
  double* const diagonal = column + j;
  const int failed = factor_block<N>(diagonal, ld, reciprocal + j, floor + j);
  if (failed >= 0) return failed;

  // The vectors that hold the diagonal block also hold rows above and below it.
  double block[N][N];
  for (int n = 0; n < N; ++n) {
    for (int i = 0; i < N; ++i) block[n][i] = i < n ? 0 : diagonal[n * ld + i];
  }
  for (std::int32_t i = top; i < bottom; i += kLanes) {
    solve_tile<1, N>(column + i, ld, nullptr, 0, nullptr, 0, 0, block[0], N, reciprocal + j);
  }
  for (int n = 0; n < N; ++n) {
    for (std::int32_t i = top; i < j; ++i) column[n * ld + i] = 0;
    for (int i = 0; i < N; ++i) diagonal[n * ld + i] = block[n][i];
  }
  for (std::int32_t i = bottom; i < end; i += kVectors * kLanes) {
    with_constant<kVectors>((end - i) / kLanes, [&]<int R>() {
      solve_tile<R, N>(column + i, ld, left + i, ld, left + j, ld, depth, diagonal, ld,
                       reciprocal + j);
    });
  }
  return -1;
}

std::int32_t panel_end(const Front& front, std::int32_t begin) {
  return begin + Kernels::kPanel < front.pivots ? begin + Kernels::kPanel : front.pivots;
}

std::int32_t factor_diagonal(const Front& front, std::int32_t begin, double* reciprocal,
                             const double* floor) {
  const std::int32_t end = panel_end(front, begin);
  const std::int64_t ld = front.ld11;
  for (std::int64_t k = 0; k < begin; k += kDepth) {
    const double* const left = front.l11 + k * ld + begin;
    subtract_product<false>(front.l11 + begin * ld + begin, ld, left, ld, left, ld,
                            round_up(end) - begin, end - begin,
                            begin - k < kDepth ? begin - k : kDepth, 0);
  }
  for (std::int32_t j = begin; j < end; j += kColumns) {
    const int failed = with_columns(end - j, [&]<int N>() {
      return factor_columns<N>(front, begin, round_up(end), j, reciprocal, floor);
    });
    if (failed >= 0) return j + failed;
  }
  return -1;
}

void solve_rows(const Front& front, std::int32_t begin, const double* reciprocal, bool below,
                std::int32_t first, std::int32_t last) {
  const std::int32_t end = panel_end(front, begin);
  const std::int64_t ld = below ? front.ld21 : front.ld11;
  double* const rows = (below ? front.l21 : front.l11) + first;
  const std::int64_t count = round_up(last) - first;
  for (std::int64_t k = 0; k < begin; k += kDepth) {
    subtract_product<false>(rows + begin * ld, ld, rows + k * ld, ld,
                            front.l11 + k * front.ld11 + begin, front.ld11, count, end - begin,
                            begin - k < kDepth ? begin - k : kDepth, end);
  }
  const double* const left = front.l11 + begin * front.ld11;
  for (std::int64_t i = 0; i < count; i += kVectors * kLanes) {
    for (std::int32_t j = begin; j < end; j += kColumns) {
      with_tile((count - i) / kLanes, end - j, [&]<int R, int N>() {
        solve_tile<R, N>(rows + j * ld + i, ld, rows + begin * ld + i, ld, left + j, front.ld11,
                         j - begin, front.l11 + j * front.ld11 + j, front.ld11, reciprocal + j);
      });
    }
  }
}

void update_rows(const Front& front, std::int32_t first, std::int32_t last) {
  const std::int64_t ld = front.ld21;
  const std::int64_t rows = round_up(last) - first;
  const std::int32_t whole = (last + kColumns - 1) / kColumns * kColumns;
  const std::int32_t columns = whole < front.rows ? whole : front.rows;
  for (std::int64_t k = 0; k < front.pivots; k += kDepth) {
    const double* const left = front.l21 + k * ld;
    const std::int64_t depth = front.pivots - k < kDepth ? front.pivots - k : kDepth;
    const auto subtract = k == 0 ? subtract_product<true> : subtract_product<false>;
    subtract(front.cb + first, ld, left + first, ld, left, ld, rows, columns, depth, first);
  }
}

}  // namespace
}  // namespace masat
