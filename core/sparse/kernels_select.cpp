#include <cstdlib>
#include <cstring>

#include "sparse/kernels.hpp"

namespace masat {

extern const Kernels kPortableKernels;
#ifdef __x86_64__
extern const Kernels kAvx2Kernels, kAvx512Kernels;
#endif

const Kernels& kernels() {
#ifdef __x86_64__
  static const Kernels& selected =
      __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
              __builtin_cpu_supports("avx512vl")
          ? kAvx512Kernels
      : __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? kAvx2Kernels
                                                                        : kPortableKernels;
  return selected;
#else
  return kPortableKernels;
#endif
}

}  // namespace masat
