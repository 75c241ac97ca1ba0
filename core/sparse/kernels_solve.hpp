// Triangular solves with the pivots of a front, for one right-hand side.
#pragma once

#include "sparse/kernels.hpp"
#include "sparse/kernels_vector.hpp"

namespace masat {
namespace {

// The sum of a vector, by halves.
inline double sum_of(Vector v) {
#if MASAT_LANES == 8
  const auto four =
      __builtin_shufflevector(v, v, 0, 1, 2, 3) + __builtin_shufflevector(v, v, 4, 5, 6, 7);
  const auto two =
      __builtin_shufflevector(four, four, 0, 1) + __builtin_shufflevector(four, four, 2, 3);
#elif MASAT_LANES == 4
  const auto two = __builtin_shufflevector(v, v, 0, 1) + __builtin_shufflevector(v, v, 2, 3);
#else
  const auto two = v;
#endif
  return two[0] + two[1];
}

// y -= a x (or y = a x) over R vectors of rows.
template <int R, bool kOverwrite>
void apply_rows(const double* a, std::int64_t lda, const double* x, std::int64_t columns,
                double* y) {
  Vector sum[R] = {};
  for (std::int64_t k = 0; k < columns; ++k, a += lda) {
    const Vector factor = Vector{} + x[k];
#pragma GCC unroll 8
    for (int r = 0; r < R; ++r) sum[r] += load(a + r * kLanes) * factor;
  }
#pragma GCC unroll 8
  for (int r = 0; r < R; ++r) {
    store(y + r * kLanes, kOverwrite ? sum[r] : load(y + r * kLanes) - sum[r]);
  }
}

template <bool kOverwrite>
[[gnu::always_inline]] inline void apply(const double* a, std::int64_t lda, const double* x,
                                         std::int64_t columns, std::int64_t rows, double* y) {
  for (std::int64_t i = 0; i < rows; i += 4 * kLanes) {
    const std::int64_t left = (rows - i) / kLanes;
    with_constant<4>(left,
                     [&]<int R>() { apply_rows<R, kOverwrite>(a + i, lda, x, columns, y + i); });
  }
}

// sum += a' y for N columns.
template <int N>
[[gnu::always_inline]] inline void add_transposed(const double* a, std::int64_t lda,
                                                  const double* y, std::int64_t rows,
                                                  Vector (&sum)[N]) {
  for (std::int64_t i = 0; i < rows; i += kLanes) {
    const Vector factor = load(y + i);
#pragma GCC unroll 8
    for (int n = 0; n < N; ++n) sum[n] += load(a + n * lda + i) * factor;
  }
}

// The N columns at `j`: solves for them, and subtracts them from the pivots below.
template <int N>
[[gnu::noinline]] void forward_columns(const Front& front, std::int32_t j, const double* reciprocal,
                                       double* x) {
  const std::int64_t ld = front.ld11;
  const double* const l = front.l11 + j * ld;
  double solved[N];
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) {
    solved[n] = x[j + n];
#pragma GCC unroll 8
    for (int k = 0; k < n; ++k) solved[n] -= l[k * ld + j + n] * solved[k];
    solved[n] *= reciprocal[j + n];
  }
  // Above the diagonal are zeros, and what this makes of the columns' own part is not kept.
  const std::int32_t top = round_down(j);
  apply<false>(l + top, ld, solved, N, round_up(front.pivots) - top, x + top);
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) x[j + n] = solved[n];
}

template <int N>
[[gnu::noinline]] void backward_columns(const Front& front, std::int32_t j,
                                        const double* reciprocal, double* x, const double* y) {
  const std::int64_t ld = front.ld11;
  const double* const l = front.l11 + j * ld;
  double own[N];
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) {
    own[n] = x[j + n];
    x[j + n] = 0;
  }
  const std::int32_t top = round_down(j + N);
  Vector sum[N] = {};
  add_transposed<N>(l + top, ld, x + top, round_up(front.pivots) - top, sum);
  add_transposed<N>(front.l21 + j * front.ld21, front.ld21, y, round_up(front.rows), sum);
#pragma GCC unroll 8
  for (int n = N - 1; n >= 0; --n) {
    own[n] -= sum_of(sum[n]);
#pragma GCC unroll 8
    for (int k = n + 1; k < N; ++k) own[n] -= l[n * ld + j + k] * own[k];
    own[n] *= reciprocal[j + n];
    x[j + n] = own[n];
  }
}

void forward(const Front& front, const double* reciprocal, double* x, double* y) {
  for (std::int32_t j = 0; j < front.pivots; j += kColumns) {
    with_columns(front.pivots - j, [&]<int N>() { forward_columns<N>(front, j, reciprocal, x); });
  }
  apply<true>(front.l21, front.ld21, x, front.pivots, round_up(front.rows), y);
}

void backward(const Front& front, const double* reciprocal, double* x, const double* y) {
  for (std::int32_t j = (front.pivots - 1) / kColumns * kColumns; j >= 0; j -= kColumns) {
    with_columns(front.pivots - j,
                 [&]<int N>() { backward_columns<N>(front, j, reciprocal, x, y); });
  }
}

}  // namespace
}  // namespace masat
