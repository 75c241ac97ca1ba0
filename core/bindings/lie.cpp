// Poses, rotations and information matrices, one a row.
#include <nanobind/nanobind.h>

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "bindings/bindings.hpp"
#include "graph/information.hpp"
#include "lie/se2.hpp"
#include "lie/se3.hpp"

namespace masat {
namespace {

using namespace nb::literals;

// Runs f(group, i) for each of `rows` rows of poses without the interpreter lock.
template <class F>
Array<double> map_poses(std::size_t rows, std::size_t pose_size, std::size_t out_size, F f) {
  std::vector<double> out(rows * out_size);
  {
    nb::gil_scoped_release release;
    with_group(pose_size, [&](auto* group) {
      for (std::size_t i = 0; i < rows; ++i) f(group, i, out.data() + i * out_size);
    });
  }
  return as_array(std::move(out), {rows, out_size});
}

Array<double> compose(const Table<double>& a, const Table<double>& b) {
  const std::size_t k = a.shape(1);
  require(a.shape(0) == b.shape(0) && b.shape(1) == k, "poses must have the same shape");
  return map_poses(a.shape(0), k, k, [&]<class Group>(Group*, std::size_t i, double* out) {
    (Group::load(a.data() + i * k) * Group::load(b.data() + i * k)).store(out);
  });
}

Array<double> inverse(const Table<double>& a) {
  const std::size_t k = a.shape(1);
  return map_poses(a.shape(0), k, k, [&]<class Group>(Group*, std::size_t i, double* out) {
    Group::load(a.data() + i * k).inverse().store(out);
  });
}

Array<double> retract(const Table<double>& a, const Table<double>& d) {
  const std::size_t k = a.shape(1), dof = k == SE2::kSize ? SE2::kDof : SE3::kDof;
  require(a.shape(0) == d.shape(0) && d.shape(1) == dof, "steps must have 3 or 6 numbers a pose");
  return map_poses(a.shape(0), k, k, [&]<class Group>(Group*, std::size_t i, double* out) {
    (Group::load(a.data() + i * k) * Group::from_tangent(d.data() + i * dof)).store(out);
  });
}

Array<double> local(const Table<double>& a, const Table<double>& b) {
  const std::size_t k = a.shape(1), dof = k == SE2::kSize ? SE2::kDof : SE3::kDof;
  require(a.shape(0) == b.shape(0) && b.shape(1) == k, "poses must have the same shape");
  return map_poses(a.shape(0), k, dof, [&]<class Group>(Group*, std::size_t i, double* out) {
    Eigen::Map<typename Group::Tangent>{out} =
        error(Group{}, Group::load(a.data() + i * k), Group::load(b.data() + i * k));
  });
}

// Rows of d x d matrices, d being 2 or 3, and poses.
Array<double> rotations_of(const Table<double>& poses) {
  const std::size_t size = poses.shape(1), n = poses.shape(0), d = size == SE2::kSize ? 2 : 3;
  std::vector<double> out(n * d * d);
  {
    nb::gil_scoped_release release;
    with_group(size, [&]<class Group>(Group*) {
      using Rows = Eigen::Matrix<double, Group::kDimension, Group::kDimension, Eigen::RowMajor>;
      for (std::size_t i = 0; i < n; ++i) {
        Eigen::Map<Rows>{&out[i * d * d]} = Group::load(poses.data() + i * size).rotation();
      }
    });
  }
  return as_array(std::move(out), {n, d, d});
}

Array<double> nearest_rotations(const Stack& matrices) {
  const std::size_t n = matrices.shape(0), d = matrices.shape(1);
  require(d == matrices.shape(2) && (d == 2 || d == 3), "matrices must be (n, 2, 2) or (n, 3, 3)");
  const std::size_t size = d == 2 ? SE2::kSize : SE3::kSize;
  return map_poses(n, size, size, [&]<class Group>(Group*, std::size_t i, double* out) {
    using Rows = Eigen::Matrix<double, Group::kDimension, Group::kDimension, Eigen::RowMajor>;
    const std::size_t step = Group::kDimension * Group::kDimension;
    Group::nearest(Eigen::Map<const Rows>(matrices.data() + i * step)).store(out);
  });
}

Array<std::int64_t> indefinite(const Stack& matrices) {
  const std::size_t d = matrices.shape(1), count = matrices.shape(0);
  require(d == matrices.shape(2) && (d == 2 || d == 3 || d == 6),
          "information matrices are 2x2, 3x3 or 6x6");
  std::vector<std::int64_t> bad;
  {
    nb::gil_scoped_release release;
    bad = d == 2   ? not_positive_definite<2>(matrices.data(), count)
          : d == 3 ? not_positive_definite<3>(matrices.data(), count)
                   : not_positive_definite<6>(matrices.data(), count);
  }
  return as_array(std::move(bad));
}

}  // namespace

void bind_lie(nb::module_& m) {
  m.def("compose", &compose, "a"_a, "b"_a);
  m.def("inverse", &inverse, "a"_a);
  m.def("retract", &retract, "a"_a, "step"_a);
  m.def("local", &local, "a"_a, "b"_a);
  m.def("rotation_matrices", &rotations_of, "poses"_a);
  m.def("nearest_rotations", &nearest_rotations, "matrices"_a);
  m.def("indefinite", &indefinite, "matrices"_a);
}

}  // namespace masat
