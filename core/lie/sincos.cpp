#include "lie/sincos.hpp"

#include <algorithm>
#include <array>

// Wider vector units where the processor has them. Without fused multiply-add, so that all of them
// round alike.
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__SANITIZE_ADDRESS__)
#define MASAT_VECTOR_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define MASAT_VECTOR_CLONES
#endif

namespace masat {
namespace {

constexpr std::int64_t kChunk = 64;
using Chunk = std::array<double, kChunk>;

MASAT_VECTOR_CLONES void sincos_chunk(const Chunk& x, Chunk& sine, Chunk& cosine) {
  for (std::int64_t k = 0; k < kChunk; ++k) {
    const SinCos r = sincos_reducible(x[k]);
    sine[k] = r.sin;
    cosine[k] = r.cos;
  }
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
