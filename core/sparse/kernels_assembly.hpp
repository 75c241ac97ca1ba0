// Extend-add: adds a child's contribution block to its parent's front.
#pragma once

#include "sparse/kernels.hpp"
#include "sparse/kernels_vector.hpp"
#ifdef __AVX512F__
#include <immintrin.h>
#endif

namespace masat {
namespace {

inline void add(double* to, const double* from, std::int32_t count) {
#ifdef __AVX512F__
  for (; count > kLanes; count -= kLanes, to += kLanes, from += kLanes) {
    _mm512_storeu_pd(to, _mm512_add_pd(_mm512_loadu_pd(to), _mm512_loadu_pd(from)));
  }
  const auto tail = static_cast<__mmask8>((1u << count) - 1);
  _mm512_mask_storeu_pd(
      to, tail, _mm512_add_pd(_mm512_maskz_loadu_pd(tail, to), _mm512_maskz_loadu_pd(tail, from)));
#else
  typedef double Loose __attribute__((vector_size(8 * kLanes), aligned(8), may_alias));
  for (; count >= kLanes; count -= kLanes, to += kLanes, from += kLanes) {
    *reinterpret_cast<Loose*>(to) += *reinterpret_cast<const Loose*>(from);
  }
  for (; count > 0; --count) *to++ += *from++;
#endif
}

void extend_add(const Front& front, const double* child, std::int64_t ld_child, bool packed,
                const Run* runs, std::int64_t count, std::int32_t first, std::int32_t last) {
  const Run* const end = runs + count;
  const Run* below = runs;  // the first run below the pivots
  while (below != end && below->target < front.pivots) ++below;
  for (const Run* run = runs; run != end && run->target < last; ++run) {
    std::int32_t c = first > run->target ? first - run->target : 0;
    const std::int32_t c_end = last - run->target < run->length ? last - run->target : run->length;
    for (; c < c_end; ++c) {
      const std::int32_t column = run->target + c;
      const std::int64_t from_column = run->source + c;
      const double* const from =
          child + from_column * ld_child - (packed ? from_column * (from_column - 1) / 2 : 0);
      double* top = nullptr;
      double* bottom;
      if (column < front.pivots) {
        top = front.l11 + column * front.ld11;
        bottom = front.l21 + column * front.ld21;
      } else {
        bottom = front.cb + (column - front.pivots) * front.ld21;
      }
      const Run* rest = run + 1;
      add(top != nullptr ? top + column : bottom + (column - front.pivots), from + run->source + c,
          run->length - c);
      for (; rest < below; ++rest) add(top + rest->target, from + rest->source, rest->length);
      for (; rest < end; ++rest) {
        add(bottom + (rest->target - front.pivots), from + rest->source, rest->length);
      }
    }
  }
}

}  // namespace
}  // namespace masat
