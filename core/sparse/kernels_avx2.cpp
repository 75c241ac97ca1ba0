// Compiled with -mavx2 -mfma.
#define MASAT_LANES 4
#define MASAT_TILE_VECTORS 2
#define MASAT_KERNELS kAvx2Kernels
#include "sparse/kernels_table.hpp"
