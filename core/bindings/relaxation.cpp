// The lifted relaxation.
#include <nanobind/nanobind.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "bindings/bindings.hpp"
#include "relaxation/certificate.hpp"
#include "relaxation/lifted.hpp"
#include "relaxation/minimizer.hpp"
#include "relaxation/pose_form.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {
namespace {

using namespace nb::literals;

// Calls f<D, P>() for a rank. It tells the dimension, which must be that of the matrix: blocks have
// as many rows in both.
template <class F>
auto with_rank(std::size_t rank, F f) {
  if (rank == 1) return f.template operator()<2, 1>();
  if (rank == 2) return f.template operator()<2, 2>();
  if (rank == 3) return f.template operator()<3, 3>();
  require(rank == 4, "ranks are 1 and 2 in 2D, 3 and 4 in 3D");
  return f.template operator()<3, 4>();
}

// Calls f with the lifted problem of a matrix, for the rank that x has, and a copy of x; without
// the interpreter lock.
template <class F>
void with_lifted(const GraphMatrix& matrix, const Stack& linear_term, double constant,
                 const Stack& x, F f) {
  require(matrix.block_size() == kLiftedRows, "blocks must have four rows");
  check_rows(matrix, x);
  check_rows(matrix, linear_term);
  require(linear_term.shape(2) == x.shape(2), "x and the linear term must have as many columns");
  with_rank(x.shape(2), [&]<int D, int P>() {
    const nb::gil_scoped_release release;
    f(Lifted<D, P>(matrix, linear_term.data(), constant),
      std::vector<double>(x.data(), x.data() + x.size()));
  });
}

Array<double> lifted_poses(const Table<double>& poses) {
  const std::size_t n = poses.shape(0), size = kLiftedRows * kLiftedRows;
  std::vector<double> out(n * size);
  with_group(poses.shape(1), [&]<class Group>(Group*) {
    for (std::size_t k = 0; k < n; ++k) {
      Eigen::Map<LiftedBlock> block(out.data() + k * size);
      block = lifted_pose(Group::load(poses.data() + k * Group::kSize));
    }
  });
  return as_array(std::move(out), {n, kLiftedRows, kLiftedRows});
}

int lifted_block_size(std::size_t rank) {
  return with_rank(rank, []<int D, int P>() { return Lifted<D, P>::kDof; });
}

// The unknowns, and -1 or the free node's index at which the minimization failed.
nb::tuple minimize_lifted(const GraphMatrix& matrix, const Stack& linear_term, double constant,
                          const Stack& initial, double decrease, double damping, int steps) {
  require(std::isfinite(decrease) && std::isfinite(damping) && damping > 0,
          "decrease must be finite, damping finite and positive");
  std::vector<double> out;
  std::int32_t failed = -1;
  with_lifted(matrix, linear_term, constant, initial,
              [&]<int D, int P>(const Lifted<D, P>& problem, std::vector<double> x) {
                failed = LiftedMinimizer<D, P>(problem).minimize(x, {decrease, damping, steps});
                out = std::move(x);
              });
  const auto shape = {initial.shape(0), initial.shape(1), initial.shape(2)};
  return nb::make_tuple(as_array(std::move(out), shape), failed);
}

double certificate_gap(const GraphMatrix& matrix, const Stack& linear_term, const Stack& x,
                       double shift, double margin) {
  require(margin >= 0, "the margin must not be negative");
  double gap = 0;
  with_lifted(matrix, linear_term, 0.0, x,
              [&]<int D, int P>(const Lifted<D, P>& problem, const std::vector<double>& at) {
                gap = Certificate<D, P>(problem, at).gap(shift, margin);
              });
  return gap;
}

Array<std::int32_t> uncertified_nodes(const GraphMatrix& matrix, const Stack& linear_term,
                                      const Stack& x, double shift) {
  std::vector<std::int32_t> found;
  with_lifted(matrix, linear_term, 0.0, x,
              [&]<int D, int P>(const Lifted<D, P>& problem, const std::vector<double>& at) {
                found = Certificate<D, P>(problem, at).uncertified(shift);
              });
  return as_array(std::move(found));
}

}  // namespace

void bind_relaxation(nb::module_& m) {
  m.def("lifted_poses", &lifted_poses, "poses"_a);
  m.def("lifted_block_size", &lifted_block_size, "rank"_a);
  m.def("minimize_lifted", &minimize_lifted, "matrix"_a, "linear_term"_a, "constant"_a, "initial"_a,
        "decrease"_a, "damping"_a, "steps"_a);
  m.def("certificate_gap", &certificate_gap, "matrix"_a, "linear_term"_a, "x"_a, "shift"_a,
        "margin"_a);
  m.def("uncertified_nodes", &uncertified_nodes, "matrix"_a, "linear_term"_a, "x"_a, "shift"_a);
}

}  // namespace masat
