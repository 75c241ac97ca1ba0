// Compiled with -mavx512f -mavx512dq -mavx512vl -mfma -mprefer-vector-width=512.
#define MASAT_LANES 8
#define MASAT_TILE_VECTORS 4
#define MASAT_KERNELS kAvx512Kernels
#include "sparse/kernels_table.hpp"
