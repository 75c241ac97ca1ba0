// The kernels, compiled once for each width of vectors. Everything included here is local to the
// including file. That file may be compiled for instructions that this machine does not have, and
// the linker must not choose its copy of a shared inline function.
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
