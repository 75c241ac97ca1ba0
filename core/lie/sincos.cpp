#include "lie/sincos.hpp"

#include <algorithm>
#include <array>

namespace masat {
namespace {

constexpr std::int64_t kChunk = 64;  // angles computed at once
using Chunk = std::array<double, kChunk>;

[[gnu::always_inline]] inline void compute_chunk(const Chunk& x, Chunk& sine, Chunk& cosine) {
  for (std::int64_t k = 0; k < kChunk; ++k) {
    const SinCos r = sincos_reducible(x[k]);
    sine[k] = r.sin;
    cosine[k] = r.cos;
  }
}

void compute_portable(const Chunk& x, Chunk& sine, Chunk& cosine) {
  compute_chunk(x, sine, cosine);
}

#ifdef __x86_64__
// Without fused multiply-add, so that all processors round alike.
[[gnu::target("avx2")]] void compute_avx2(const Chunk& x, Chunk& sine, Chunk& cosine) {
  compute_chunk(x, sine, cosine);
}
#endif

void sincos_chunk(const Chunk& x, Chunk& sine, Chunk& cosine) {
#ifdef __x86_64__
  static const bool has_avx2 = __builtin_cpu_supports("avx2");
  if (has_avx2) return compute_avx2(x, sine, cosine);
#endif
  compute_portable(x, sine, cosine);
}

}  // namespace

void sincos(const double* x, std::int64_t stride, std::int64_t count, SinCos* out) {
  Chunk angle{}, sine, cosine;
  for (std::int64_t begin = 0; begin < count; begin += kChunk) {
    const std::int64_t n = std::min(kChunk, count - begin);
    double largest = 0;
    for (std::int64_t k = 0; k < n; ++k) {
      angle[k] = x[(begin + k) * stride];
      largest = std::max(largest, std::abs(angle[k]));
    }
    if (largest < kReducible) {
      sincos_chunk(angle, sine, cosine);
      for (std::int64_t k = 0; k < n; ++k) out[begin + k] = {sine[k], cosine[k]};
    } else {
      for (std::int64_t k = 0; k < n; ++k) out[begin + k] = sincos(angle[k]);
    }
  }
}

}  // namespace masat
