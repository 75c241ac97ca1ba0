// 128-bit vectors: SSE2, NEON.
#define MASAT_LANES 2
#if defined(__aarch64__)
#define MASAT_TILE_VECTORS 4
#else
#define MASAT_TILE_VECTORS 2
#endif
#define MASAT_KERNELS kPortableKernels
#include "sparse/kernels_table.hpp"
