// What the files of this folder share: a function a topic, and the checks of more than one.
#pragma once

#include <nanobind/nanobind.h>

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

}  // namespace masat
