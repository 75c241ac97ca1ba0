// The kernels, once for each width of vectors. Everything here and below is local to the including
// file, which may be compiled for more than the machine can do: no inline function may be shared.
#include "sparse/kernels.hpp"
#include "sparse/kernels_assembly.hpp"
#include "sparse/kernels_factor.hpp"
#include "sparse/kernels_solve.hpp"

namespace masat {

extern const Kernels MASAT_KERNELS;
const Kernels MASAT_KERNELS = {kLanes,          kWidth,          factor_diagonal, solve_rows,
                               update_rows,     extend_add,      forward<1>,      backward<1>,
                               forward<kWidth>, backward<kWidth>};

}  // namespace masat
