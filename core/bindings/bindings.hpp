// What the files of this folder share: a function a topic, and the checks of more than one.
#pragma once

#include <nanobind/nanobind.h>

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"

namespace masat {

class GraphMatrix;
class Topology;

// Types are bound before their use: the order is module.cpp's.
void bind_lie(nb::module_& m);
void bind_graph(nb::module_& m);
void bind_systems(nb::module_& m);
void bind_relaxation(nb::module_& m);
void bind_equations(nb::module_& m);
void bind_text(nb::module_& m);

void check_poses(const Topology& graph, const Table<double>& measurements,
                 const Table<double>& poses);
void check_rows(const GraphMatrix& matrix, const Stack& v);

// Blocks of the inverse of what a system of d rows a node factorized, by places among its nodes.
template <class System>
Array<double> blocks_of_inverse(const System& system, std::int32_t nodes, std::size_t d,
                                const Vector<std::int32_t>& rows,
                                const Vector<std::int32_t>& columns) {
  require(rows.shape(0) == columns.shape(0), "as many rows as columns");
  for (const auto& places : {span_of(rows), span_of(columns)}) {
    for (const std::int32_t k : places) require(k >= 0 && k < nodes, "block out of range");
  }
  std::vector<double> out(rows.shape(0) * d * d);
  {
    nb::gil_scoped_release release;
    system.inverse(span_of(rows), span_of(columns), out.data());
  }
  return as_array(std::move(out), {rows.shape(0), d, d});
}

}  // namespace masat
