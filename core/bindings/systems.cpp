// Linear systems over the graph: elimination, factorization, and translations at fixed rotations.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/unique_ptr.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "bindings/bindings.hpp"
#include "bindings/parts.hpp"
#include "factors/relative_pose.hpp"
#include "factors/sensor.hpp"
#include "graph/topology.hpp"
#include "optimizers/translations.hpp"
#include "relaxation/pose_form.hpp"
#include "sparse/elimination.hpp"
#include "sparse/graph_matrix.hpp"
#include "sparse/multifrontal.hpp"

namespace masat {

void check_rows(const GraphMatrix& matrix, const Stack& v) {
  const std::size_t d = matrix.block_size();
  require(v.shape(0) * d == static_cast<std::size_t>(matrix.rows()) && v.shape(1) == d,
          "a table must be (free nodes, d, k)");
}

namespace {

using namespace nb::literals;

using AnyArray = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;

std::shared_ptr<Elimination> make_elimination(const Topology& graph, const Vector<bool>& fixed,
                                              const Vector<std::int32_t>& order,
                                              std::int32_t boundary, std::int32_t elements) {
  require(fixed.shape(0) == static_cast<std::size_t>(graph.nodes()), "one flag a node");
  std::vector<bool> seen(order.shape(0));
  for (const std::int32_t k : span_of(order)) {
    require(k >= 0 && static_cast<std::size_t>(k) < seen.size() && !seen[k],
            "the order must be a permutation");
    seen[k] = true;
  }
  const auto free = std::count(fixed.data(), fixed.data() + fixed.shape(0), false);
  require(seen.empty() || static_cast<std::ptrdiff_t>(seen.size()) == free,
          "the order must name each free node once");
  require(boundary >= 0 && elements >= 0 && boundary + elements <= free &&
              (boundary + elements == 0 || !seen.empty()),
          "boundary and elements are some of the free nodes, in a given order");
  nb::gil_scoped_release release;
  return std::make_shared<Elimination>(graph, span_of(fixed), span_of(order),
                                       Interface{boundary, elements});
}

// The neighbors of each free node as compressed rows, by indices among the free nodes.
nb::tuple adjacency_of(const Elimination& elimination) {
  std::vector<std::int64_t> start{0};
  std::vector<std::int32_t> neighbors;
  for (std::int32_t k = 0; k < elimination.adjacency().nodes(); ++k) {
    for (const auto& neighbor : elimination.adjacency().neighbors(k)) {
      neighbors.push_back(neighbor.node);
    }
    start.push_back(static_cast<std::int64_t>(neighbors.size()));
  }
  return nb::make_tuple(as_array(std::move(start)), as_array(std::move(neighbors)));
}

std::unique_ptr<GraphMatrix> make_matrix(std::shared_ptr<Elimination> elimination, int block_size) {
  require(block_size >= 1 && block_size <= kLargestBlock, "blocks have 1 to 10 rows");
  nb::gil_scoped_release release;
  return std::make_unique<GraphMatrix>(std::move(elimination), block_size);
}

void check_graph(const GraphMatrix& matrix, const Topology& graph) {
  // The elimination of a part has further edges, to its elements.
  require(graph.nodes() == matrix.elimination()->nodes() &&
              static_cast<std::int64_t>(graph.edges().size()) <= matrix.elimination()->edges(),
          "the elimination must be of the same graph");
}

void check_values(const GraphMatrix& matrix, const Topology& graph, const Stack& values) {
  check_graph(matrix, graph);
  require(values.shape(0) == static_cast<std::size_t>(graph.nodes()) &&
              values.shape(1) == static_cast<std::size_t>(matrix.block_size()),
          "values must be (n, d, k)");
}

Array<double> assembled(GraphMatrix& matrix, const Topology& graph, const Stack& first,
                        const Stack& joint, const Stack& second, const Stack& values) {
  const std::size_t d = matrix.block_size(), columns = values.shape(2);
  for (const Stack* blocks : {&first, &joint, &second}) {
    require(
        blocks->shape(0) == graph.edges().size() && blocks->shape(1) == d && blocks->shape(2) == d,
        "the blocks of the edges must be (m, d, d)");
  }
  check_values(matrix, graph, values);
  std::vector<double> rhs(matrix.rows() * columns);
  {
    nb::gil_scoped_release release;
    matrix.set_zero();
    for (std::size_t k = 0; k < graph.edges().size(); ++k) {
      const std::size_t at = k * d * d;
      matrix.add_edge(graph, static_cast<std::int64_t>(k), first.data() + at, joint.data() + at,
                      second.data() + at, values.data(), static_cast<int>(columns), rhs.data());
    }
  }
  return as_array(std::move(rhs), {matrix.rows() / d, d, columns});
}

Array<double> assembled_poses(GraphMatrix& matrix, const Topology& graph,
                              const Table<double>& measurements, const AnyArray& rotation,
                              const Vector<double>& translation, const Stack& values,
                              const std::optional<Table<double>>& offsets) {
  const std::size_t m = graph.edges().size(), d = matrix.block_size(), columns = values.shape(2);
  require(rotation.ndim() >= 1 && measurements.shape(0) == m && rotation.shape(0) == m &&
              translation.shape(0) == m,
          "one row an edge");
  require(!offsets || (offsets->shape(0) == m && offsets->shape(1) == measurements.shape(1)),
          "one offset an edge");
  const bool matrices = rotation.ndim() == 3;
  check_values(matrix, graph, values);
  std::vector<double> rhs(matrix.rows() * columns);
  {
    nb::gil_scoped_release release;
    with_group(measurements.shape(1), [&]<class Group>(Group*) {
      require(d == kLiftedRows, "blocks must have four rows");
      require(matrices ? Group::kDimension == 3 && rotation.shape(1) == 3 && rotation.shape(2) == 3
                       : rotation.ndim() == 1,
              "the rotations' weights must be (m,), or (m, 3, 3) in 3D");
      assemble_pose_form<Group>(matrix, graph, measurements.data(), {rotation.data(), matrices},
                                translation.data(), offsets ? offsets->data() : nullptr,
                                values.data(), static_cast<int>(columns), rhs.data());
    });
  }
  return as_array(std::move(rhs), {matrix.rows() / d, d, columns});
}

// Calls f with the factors of measured translations, and with the group.
template <class F>
void with_translations(const Topology& graph, const GraphMatrix& matrix,
                       const Table<double>& measurements, const Stack& information,
                       const Table<double>& poses, const std::optional<Table<double>>& offsets,
                       F f) {
  check_poses(graph, measurements, poses);
  check_graph(matrix, graph);
  const double* const moved = data_of(offsets, measurements.shape(0), poses.shape(1));
  with_group(poses.shape(1), [&]<class Group>(Group* group) {
    require(matrix.block_size() == Group::kDimension, "blocks must have a row a coordinate");
    require(information.shape(0) == graph.edges().size() && information.shape(1) == Group::kDof &&
                information.shape(2) == Group::kDof,
            "information must be (m, d, d)");
    nb::gil_scoped_release release;
    if (moved == nullptr) {
      f(group, RelativePoseFactors<Group>(graph.edges(), measurements.data(), information.data()));
    } else {
      f(group, SensorFactors<Group>(graph.edges(), measurements.data(), information.data(), moved,
                                    nullptr));
    }
  });
}

Array<double> assembled_translations(GraphMatrix& matrix, const Topology& graph,
                                     const Table<double>& measurements, const Stack& information,
                                     const Table<double>& poses,
                                     const std::optional<Table<double>>& offsets) {
  std::vector<double> rhs;
  with_translations(graph, matrix, measurements, information, poses, offsets,
                    [&]<class Group>(Group*, const auto& factors) {
                      rhs = assemble_translations<Group>(
                          factors, matrix, typename Group::Table(poses.data(), graph.nodes()));
                    });
  const std::size_t d = matrix.block_size();
  return as_array(std::move(rhs), {matrix.rows() / d, d, 1});
}

// The poses, and -1 or the node whose translation is not determined.
nb::tuple solved_translations(const Topology& graph, GraphMatrix& matrix,
                              const Table<double>& measurements, const Stack& information,
                              const Table<double>& poses,
                              const std::optional<Table<double>>& offsets) {
  std::int32_t failed = -1;
  std::vector<double> out(poses.data(), poses.data() + poses.size());
  with_translations(graph, matrix, measurements, information, poses, offsets,
                    [&]<class Group>(Group*, const auto& factors) {
                      failed = solve_translations<Group>(factors, matrix, out.data());
                    });
  return nb::make_tuple(as_array(std::move(out), {poses.shape(0), poses.shape(1)}), failed);
}

}  // namespace

void bind_systems(nb::module_& m) {
  nb::class_<Elimination>(m, "Elimination")
      .def(nb::new_(&make_elimination), "topology"_a, "fixed"_a, "order"_a, "boundary"_a = 0,
           "elements"_a = 0)
      .def("free_nodes",
           [](const Elimination& e) {
             return as_array(
                 std::vector<std::int32_t>(e.free_nodes().begin(), e.free_nodes().end()));
           })
      .def("adjacency", &adjacency_of)
      .def("order",
           [](const Elimination& e) { return as_array(std::vector<std::int32_t>(e.tree().order)); })
      .def(
          "parents",
          [](const Elimination& e) { return as_array(std::vector<std::int32_t>(e.tree().parent)); })
      .def(
          "factor_bytes",
          [](const Elimination& e, int block_size) {
            return e.layout(block_size).factor_size() * static_cast<std::int64_t>(sizeof(double));
          },
          "block_size"_a)
      .def("fill", &Elimination::fill, "block_size"_a)
      .def("operations", &Elimination::operations, "block_size"_a);

  nb::class_<GraphMatrix> matrix(m, "GraphMatrix");
  matrix.def(nb::new_(&make_matrix), "elimination"_a, "block_size"_a)
      .def("assemble", &assembled, "topology"_a, "first"_a, "joint"_a, "second"_a, "values"_a)
      .def("assemble_poses", &assembled_poses, "topology"_a, "measurements"_a, "rotation"_a,
           "translation"_a, "values"_a, "offsets"_a = nb::none())
      .def("assemble_translations", &assembled_translations, "topology"_a, "measurements"_a,
           "information"_a, "poses"_a, "offsets"_a = nb::none())
      .def("pivot_ratio", &GraphMatrix::pivot_ratio)
      .def(
          "solve",
          [](const GraphMatrix& matrix, const Stack& rhs) {
            check_rows(matrix, rhs);
            std::vector<double> out(rhs.data(), rhs.data() + rhs.size());
            {
              nb::gil_scoped_release release;
              matrix.solve(out, static_cast<int>(rhs.shape(2)));
            }
            return as_array(std::move(out), {rhs.shape(0), rhs.shape(1), rhs.shape(2)});
          },
          "rhs"_a)
      .def(
          "inverse",
          [](const GraphMatrix& matrix, const Vector<std::int32_t>& rows,
             const Vector<std::int32_t>& columns) {
            return blocks_of_inverse(matrix, matrix.pattern().columns(), matrix.block_size(), rows,
                                     columns);
          },
          "rows"_a, "columns"_a);
  bind_part(matrix);

  m.def("free_workspace", &Multifrontal::free_workspace);
  m.def("solve_translations", &solved_translations, "topology"_a, "matrix"_a, "measurements"_a,
        "information"_a, "poses"_a, "offsets"_a = nb::none());
}

}  // namespace masat
