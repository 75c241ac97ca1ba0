// What the files of this folder share: one function that binds each topic, and common checks.
#pragma once

#include <nanobind/nanobind.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"

namespace masat {

class Elimination;
class GraphMatrix;
class NormalEquations;
class Topology;

// A type must be bound before its first use, so module.cpp calls these in order.
void bind_lie(nb::module_& m);
void bind_graph(nb::module_& m);
void bind_systems(nb::module_& m);
void bind_relaxation(nb::module_& m);
void bind_equations(nb::module_& m);
void bind_text(nb::module_& m);
void bind_online(nb::module_& m);

void check_poses(const Topology& graph, const Table<double>& measurements,
                 const Table<double>& poses);
void check_rows(const GraphMatrix& matrix, const Stack& v);

// In a file of its own: a second instance of the loop over the edges in one file makes the compiler
// inline less of both.
std::unique_ptr<NormalEquations> sensor_equations(nb::object topology,
                                                  std::shared_ptr<Elimination> elimination,
                                                  const Table<double>& measurements,
                                                  const Stack& information,
                                                  const std::optional<Table<double>>& offsets,
                                                  const std::optional<Vector<bool>>& range_bearing,
                                                  int threads);

// Blocks of the inverse of a factorized system of d rows a node, by indices among its nodes.
template <class System>
Array<double> blocks_of_inverse(const System& system, std::int32_t nodes, std::size_t d,
                                const Vector<std::int32_t>& rows,
                                const Vector<std::int32_t>& columns) {
  require(rows.shape(0) == columns.shape(0), "as many rows as columns");
  for (const auto& indices : {span_of(rows), span_of(columns)}) {
    for (const std::int32_t k : indices) require(k >= 0 && k < nodes, "block out of range");
  }
  std::vector<double> out(rows.shape(0) * d * d);
  {
    nb::gil_scoped_release release;
    system.inverse(span_of(rows), span_of(columns), out.data());
  }
  return as_array(std::move(out), {rows.shape(0), d, d});
}

}  // namespace masat
