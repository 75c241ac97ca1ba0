// The system of a part of a graph, whether of NormalEquations or a GraphMatrix.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "optimizers/normal_equations.hpp"
#include "sparse/elimination.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

using ElementArrays = std::pair<Vector<std::int32_t>, Vector<double>>;

inline int block_size_of(const NormalEquations& system) { return system.dof(); }
inline int block_size_of(const GraphMatrix& system) { return system.block_size(); }
inline const Elimination& elimination_of(const NormalEquations& system) {
  return system.elimination();
}
inline const Elimination& elimination_of(const GraphMatrix& system) {
  return *system.elimination();
}
template <class System>
std::size_t rows_of(const System& system) {
  return elimination_of(system).free_nodes().size() * block_size_of(system);
}

// Factorizes; each element is a pair of node indices, among the free ones, and a packed block.
template <class System>
std::int32_t factorize_part(System& system, const Vector<double>& damping,
                            const std::vector<ElementArrays>& given) {
  require(damping.shape(0) == rows_of(system), "damping must have an entry a row");
  const Elimination& elimination = elimination_of(system);
  const std::int32_t count = elimination.tree().interface.elements;
  require(static_cast<std::int32_t>(given.size()) == count, "one block an element");
  std::vector<Element> elements;
  for (const auto& [nodes, block] : given) {
    const auto element =
        static_cast<std::int32_t>(elimination.free_nodes().size() - count + elements.size());
    std::vector<std::int32_t> joined, named(nodes.data(), nodes.data() + nodes.shape(0));
    for (const auto& neighbor : elimination.adjacency().neighbors(element)) {
      joined.push_back(neighbor.node);
    }
    std::sort(joined.begin(), joined.end());
    std::sort(named.begin(), named.end());
    require(joined == named, "an element has the nodes that it is joined to");
    const std::size_t scalars = nodes.shape(0) * block_size_of(system);
    require(block.shape(0) == scalars * (scalars + 1) / 2, "an element is a packed triangle");
    elements.push_back({span_of(nodes), block.data()});
  }
  nb::gil_scoped_release release;
  return system.factorize(span_of(damping), elements);
}

// A copy of a vector with an entry a row, changed by `change` without the interpreter's lock.
template <class System, class Change>
Array<double> changed(const System& system, const Vector<double>& v, Change change) {
  require(v.shape(0) == rows_of(system), "the vector must have an entry a row");
  std::vector<double> out(v.data(), v.data() + v.shape(0));
  {
    nb::gil_scoped_release release;
    change(std::span<double>(out));
  }
  return as_array(std::move(out));
}

template <class System>
void bind_part(nb::class_<System>& bound) {
  using namespace nb::literals;
  bound
      .def("factorize", &factorize_part<System>, "damping"_a,
           "elements"_a = std::vector<ElementArrays>())
      .def("contribution", [](const System& s) { return as_array(s.contribution()); })
      .def(
          "reduce",
          [](const System& s, const Vector<double>& rhs) {
            return changed(s, rhs, [&](std::span<double> v) { s.reduce(v); });
          },
          "rhs"_a)
      .def(
          "substitute",
          [](const System& s, const Vector<double>& x) {
            return changed(s, x, [&](std::span<double> v) { s.substitute(v); });
          },
          "x"_a);
}

}  // namespace masat
