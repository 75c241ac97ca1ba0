// The lifted relaxation.
#include <nanobind/nanobind.h>

#include <cstddef>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "bindings/bindings.hpp"
#include "relaxation/lifted.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {
namespace {

using namespace nb::literals;

// Calls f with the lifted problem of a matrix, for the rank that x has.
template <class F>
void with_lifted(const GraphMatrix& matrix, const Stack& forcing, double constant, const Stack& x,
                 F f) {
  check_rows(matrix, x);
  check_rows(matrix, forcing);
  require(forcing.shape(2) == x.shape(2), "x and the forcing must have as many columns");
  const auto rank = x.shape(2);
  const auto call = [&]<int D, int P>() { f(Lifted<D, P>(matrix, forcing.data(), constant)); };
  if (matrix.block_size() == 3 && rank == 2) {
    call.template operator()<2, 2>();
  } else if (matrix.block_size() == 3 && rank == 4) {
    call.template operator()<2, 4>();
  } else if (matrix.block_size() == 4 && rank == 3) {
    call.template operator()<3, 3>();
  } else {
    require(matrix.block_size() == 4 && rank == 4, "ranks are 2 and 4 in 2D, 3 and 4 in 3D");
    call.template operator()<3, 4>();
  }
}

nb::tuple minimize_lifted(const GraphMatrix& matrix, const Stack& forcing, double constant,
                          const Stack& start, double decrease, double damping, int steps) {
  std::vector<double> x(start.data(), start.data() + start.size());
  int taken = 0;
  with_lifted(matrix, forcing, constant, start, [&](auto problem) {
    const nb::gil_scoped_release release;
    taken = problem.minimize(x, {decrease, damping, steps});
  });
  return nb::make_tuple(as_array(std::move(x), {start.shape(0), start.shape(1), start.shape(2)}),
                        taken);
}

double lifted_gap(const GraphMatrix& matrix, const Stack& forcing, const Stack& x, double shift) {
  double gap = 0;
  with_lifted(matrix, forcing, 0.0, x, [&](auto problem) {
    const nb::gil_scoped_release release;
    gap = problem.gap({x.data(), x.data() + x.size()}, shift);
  });
  return gap;
}

Array<std::int32_t> weak_nodes(const GraphMatrix& matrix, const Stack& forcing, const Stack& x,
                               double shift) {
  std::vector<std::int32_t> found;
  with_lifted(matrix, forcing, 0.0, x, [&](auto problem) {
    const nb::gil_scoped_release release;
    found = problem.weak({x.data(), x.data() + x.size()}, shift);
  });
  return as_array(std::move(found));
}

}  // namespace

void bind_relaxation(nb::module_& m) {
  m.def("minimize_lifted", &minimize_lifted, "matrix"_a, "forcing"_a, "constant"_a, "start"_a,
        "decrease"_a, "damping"_a, "steps"_a);
  m.def("lifted_gap", &lifted_gap, "matrix"_a, "forcing"_a, "x"_a, "shift"_a);
  m.def("weak_nodes", &weak_nodes, "matrix"_a, "forcing"_a, "x"_a, "shift"_a);
}

}  // namespace masat
