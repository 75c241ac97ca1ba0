// NumPy arrays as arguments and results of the core.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <initializer_list>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "lie/se2.hpp"
#include "lie/se3.hpp"

namespace masat {

namespace nb = nanobind;

template <class T>
using Vector = nb::ndarray<const T, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <class T>
using Table = nb::ndarray<const T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Stack = nb::ndarray<const double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
template <class T>
using Array = nb::ndarray<nb::numpy, T>;

// An array that owns the memory of the vector.
template <class T>
Array<T> as_array(std::vector<T>&& values, std::initializer_list<std::size_t> shape) {
  auto* const owned = new std::vector<T>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return Array<T>(owned->data(), shape, owner);
}
template <class T>
Array<T> as_array(std::vector<T>&& values) {
  const std::size_t size = values.size();
  return as_array(std::move(values), {size});
}

inline void require(bool condition, const char* what) {
  if (!condition) throw std::invalid_argument(what);
}

template <class T>
std::span<const T> span_of(const Vector<T>& v) {
  return {v.data(), v.shape(0)};
}

// The data of a table of as many rows and columns, or null without one.
inline const double* data_of(const std::optional<Table<double>>& table, std::size_t rows,
                             std::size_t columns) {
  if (!table) return nullptr;
  require(table->shape(0) == rows && table->shape(1) == columns, "one offset an edge");
  return table->data();
}

// The flags of a table of as many rows, or null without any.
inline const bool* flags_of(const std::optional<Vector<bool>>& flags, std::size_t rows) {
  if (!flags) return nullptr;
  require(flags->shape(0) == rows, "one flag an edge");
  return flags->data();
}

// Calls f with a null pointer to the group whose poses have that many numbers.
template <class F>
auto with_group(std::size_t pose_size, F f) {
  require(pose_size == SE2::kSize || pose_size == SE3::kSize, "poses have 3 or 7 numbers");
  return pose_size == SE2::kSize ? f(static_cast<SE2*>(nullptr)) : f(static_cast<SE3*>(nullptr));
}

// A copy of `poses` that `place(group, out)` has changed without the interpreter lock.
template <class F>
Array<double> placed(const Table<double>& poses, F place) {
  std::vector<double> out(poses.data(), poses.data() + poses.size());
  {
    nb::gil_scoped_release release;
    with_group(poses.shape(1), [&](auto* group) { place(group, out.data()); });
  }
  return as_array(std::move(out), {poses.shape(0), poses.shape(1)});
}

}  // namespace masat
