// Triangular solves with the pivots of a front, for one right-hand side or for kWidth side by side.
#pragma once

#include "sparse/kernels.hpp"
#include "sparse/kernels_vector.hpp"

namespace masat {
namespace {

typedef double Wide __attribute__((vector_size(8 * kWidth), may_alias));

// A row of one right-hand side, or of kWidth side by side.
template <int kCount>
struct Row {
  typedef double Value;
  typedef Vector Sum;
  static constexpr std::int32_t kStep = kLanes;  // rows processed at once
};
template <>
struct Row<kWidth> {
  typedef Wide Value, Sum;
  static constexpr std::int32_t kStep = 2;
};

// The lower and the upper half of a vector, added. GCC 11 makes a little slower code of the loads.
typedef double Two __attribute__((vector_size(16), may_alias));
typedef double Four __attribute__((vector_size(32), may_alias));
#if __has_builtin(__builtin_shufflevector)
#if MASAT_LANES == 8
inline Four add_halves(const Vector& v) {
  return __builtin_shufflevector(v, v, 0, 1, 2, 3) + __builtin_shufflevector(v, v, 4, 5, 6, 7);
}
#endif
#if MASAT_LANES >= 4
inline Two add_halves(const Four& v) {
  return __builtin_shufflevector(v, v, 0, 1) + __builtin_shufflevector(v, v, 2, 3);
}
#endif
#else
#if MASAT_LANES == 8
inline Four add_halves(const Vector& v) {
  const auto* const half = reinterpret_cast<const Four*>(&v);
  return half[0] + half[1];
}
#endif
#if MASAT_LANES >= 4
inline Two add_halves(const Four& v) {
  const auto* const half = reinterpret_cast<const Two*>(&v);
  return half[0] + half[1];
}
#endif
#endif

// x -= the sum of a vector, in the same order for all compilers.
inline void subtract_sum(double& x, const Vector& v) {
#if MASAT_LANES == 8
  const Two two = add_halves(add_halves(v));
#elif MASAT_LANES == 4
  const Two two = add_halves(v);
#else
  const Two& two = v;
#endif
  x -= two[0] + two[1];
}
inline void subtract_sum(Wide& x, const Wide& sum) { x -= sum; }

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

// Reading row by row, the processor does not fetch the next columns by itself in time.
template <int N>
[[gnu::always_inline]] inline void prefetch(const double* a, std::int64_t lda, std::int64_t row) {
  constexpr std::int64_t kLine = 8;
  if (row % kLine != 0) return;
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) __builtin_prefetch(a + n * lda + row);
}

template <bool kOverwrite>
[[gnu::always_inline]] inline void apply(const double* a, std::int64_t lda, const Wide* x,
                                         std::int64_t columns, std::int64_t rows, Wide* y) {
  for (std::int64_t k = 0; k < columns; k += kColumns, a += kColumns * lda, x += kColumns) {
    with_columns(columns - k, [&]<int N>() {
      for (std::int64_t i = 0; i < rows; ++i) {
        prefetch<N>(a + kColumns * lda, lda, i);
        Wide sum = kOverwrite && k == 0 ? Wide{} : y[i];
#pragma GCC unroll 8
        for (int n = 0; n < N; ++n) {
          const Wide product = x[n] * a[n * lda + i];
          sum = kOverwrite ? sum + product : sum - product;
        }
        y[i] = sum;
      }
    });
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

template <int N>
[[gnu::always_inline]] inline void add_transposed(const double* a, std::int64_t lda, const Wide* y,
                                                  std::int64_t rows, Wide (&sum)[N]) {
  Wide odd[N] = {};
  for (std::int64_t i = 0; i < rows; i += 2) {
    prefetch<N>(a - kColumns * lda, lda, i);
#pragma GCC unroll 8
    for (int n = 0; n < N; ++n) {
      sum[n] += y[i] * a[n * lda + i];
      odd[n] += y[i + 1] * a[n * lda + i + 1];
    }
  }
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) sum[n] += odd[n];
}

// The N columns at `j`: solves for them, and subtracts them from the pivots below.
template <int N, int kCount>
[[gnu::noinline]] void forward_columns(const Front& front, std::int32_t j, const double* reciprocal,
                                       typename Row<kCount>::Value* x) {
  const std::int64_t ld = front.ld11;
  const double* const l = front.l11 + j * ld;
  typename Row<kCount>::Value solved[N];
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) {
    solved[n] = x[j + n];
#pragma GCC unroll 8
    for (int k = 0; k < n; ++k) solved[n] -= l[k * ld + j + n] * solved[k];
    solved[n] *= reciprocal[j + n];
  }
  // The first vector may also change the columns' own part, which is overwritten below.
  constexpr std::int32_t kStep = Row<kCount>::kStep;
  const std::int32_t top = round_down<kStep>(j + N);
  apply<false>(l + top, ld, solved, N, round_up<kStep>(front.pivots) - top, x + top);
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) x[j + n] = solved[n];
}

template <int N, int kCount>
[[gnu::noinline]] void backward_columns(const Front& front, std::int32_t j,
                                        const double* reciprocal, typename Row<kCount>::Value* x,
                                        const typename Row<kCount>::Value* y) {
  const std::int64_t ld = front.ld11;
  const double* const l = front.l11 + j * ld;
  typename Row<kCount>::Value own[N];
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) {
    own[n] = x[j + n];
    x[j + n] = typename Row<kCount>::Value{};
  }
  constexpr std::int32_t kStep = Row<kCount>::kStep;
  const std::int32_t top = round_down<kStep>(j + N);
  typename Row<kCount>::Sum sum[N] = {};
  add_transposed<N>(l + top, ld, x + top, round_up<kStep>(front.pivots) - top, sum);
  add_transposed<N>(front.l21 + j * front.ld21, front.ld21, y, round_up<kStep>(front.rows), sum);
#pragma GCC unroll 8
  for (int n = N - 1; n >= 0; --n) {
    subtract_sum(own[n], sum[n]);
#pragma GCC unroll 8
    for (int k = n + 1; k < N; ++k) own[n] -= l[n * ld + j + k] * own[k];
    own[n] *= reciprocal[j + n];
    x[j + n] = own[n];
  }
}

template <int kCount>
void forward(const Front& front, const double* reciprocal, double* pivots, double* rows) {
  auto* const x = reinterpret_cast<typename Row<kCount>::Value*>(pivots);
  auto* const y = reinterpret_cast<typename Row<kCount>::Value*>(rows);
  for (std::int32_t j = 0; j < front.pivots; j += kColumns) {
    with_columns(front.pivots - j,
                 [&]<int N>() { forward_columns<N, kCount>(front, j, reciprocal, x); });
  }
  apply<true>(front.l21, front.ld21, x, front.pivots, round_up<Row<kCount>::kStep>(front.rows), y);
}

template <int kCount>
void backward(const Front& front, const double* reciprocal, double* pivots, const double* rows) {
  auto* const x = reinterpret_cast<typename Row<kCount>::Value*>(pivots);
  const auto* const y = reinterpret_cast<const typename Row<kCount>::Value*>(rows);
  for (std::int32_t j = (front.pivots - 1) / kColumns * kColumns; j >= 0; j -= kColumns) {
    with_columns(front.pivots - j,
                 [&]<int N>() { backward_columns<N, kCount>(front, j, reciprocal, x, y); });
  }
}

}  // namespace
}  // namespace masat
