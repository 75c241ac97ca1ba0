// Vectors of MASAT_LANES doubles, and the products of tiles kept in registers.
#pragma once

#include <cstdint>

namespace masat {
namespace {

typedef double Vector __attribute__((vector_size(8 * MASAT_LANES), may_alias));

constexpr std::int32_t kLanes = MASAT_LANES;
constexpr std::int32_t kVectors = MASAT_TILE_VECTORS;     // rows of a tile
constexpr std::int32_t kColumns = 6;                      // of a tile
constexpr std::int32_t kWidth = kLanes < 4 ? kLanes : 4;  // right-hand sides in a wide solve
constexpr std::int64_t kDepth = 96;  // columns whose tile of rows fits the first-level cache

inline Vector load(const double* p) { return *reinterpret_cast<const Vector*>(p); }
inline void store(double* p, Vector v) { *reinterpret_cast<Vector*>(p) = v; }

template <std::int32_t kStep = kLanes, class Int>
constexpr Int round_down(Int x) {
  return x & -Int{kStep};
}
template <std::int32_t kStep = kLanes, class Int>
constexpr Int round_up(Int x) {
  return round_down<kStep>(x + kStep - 1);
}

// sum = a b' for R vectors of rows of a and N rows of b.
template <int R, int N>
[[gnu::always_inline]] inline void multiply_tile(const double* a, std::int64_t lda, const double* b,
                                                 std::int64_t ldb, std::int64_t depth,
                                                 Vector (&sum)[N][R]) {
#pragma GCC unroll 8
  for (int n = 0; n < N; ++n) {
#pragma GCC unroll 8
    for (int r = 0; r < R; ++r) sum[n][r] = Vector{};
  }
  for (std::int64_t k = 0; k < depth; ++k, a += lda, b += ldb) {
    Vector rows[R];
#pragma GCC unroll 8
    for (int r = 0; r < R; ++r) rows[r] = load(a + r * kLanes);
#pragma GCC unroll 8
    for (int n = 0; n < N; ++n) {
      const Vector column = Vector{} + b[n];
#pragma GCC unroll 8
      for (int r = 0; r < R; ++r) sum[n][r] += rows[r] * column;
    }
  }
}

// Calls f with min(left, kMost) as a compile-time constant.
template <int kMost, class F>
[[gnu::always_inline]] inline auto with_constant(std::int64_t left, F f) {
  if constexpr (kMost > 1) {
    if (left < kMost) return with_constant<kMost - 1>(left, f);
  }
  return f.template operator()<kMost>();
}

// The same for the columns of a tile. Large functions that f calls must not be inlined, or all of
// them would share one large stack frame.
template <class F>
[[gnu::always_inline]] inline auto with_columns(std::int64_t left, F f) {
  if (left >= kColumns) return f.template operator()<kColumns>();
  if (left == 3) return f.template operator()<3>();  // the only other case for blocks of 3 rows
  return with_constant<kColumns - 1>(left, f);
}

// Calls f with the number of vectors and of columns of the next tile.
template <class F>
[[gnu::always_inline]] inline void with_tile(std::int64_t vectors, std::int64_t columns, F f) {
  with_columns(columns, [&]<int N>() {
    with_constant<kVectors>(vectors, [&]<int R>() { f.template operator()<R, N>(); });
  });
}

}  // namespace
}  // namespace masat
