// The Python face of the core, described for readers in src/masat/_core.pyi.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <optional>

#include "arrays.hpp"
#include "graph/information.hpp"
#include "graph/topology.hpp"
#include "initializers/placement.hpp"
#include "initializers/toro.hpp"
#include "initializers/translations.hpp"
#include "lie/se2.hpp"
#include "lie/se3.hpp"
#include "optimizers/normal_equations.hpp"
#include "relaxation/lifted.hpp"
#include "sparse/graph_matrix.hpp"
#include "text/records.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace masat {
namespace {

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

Array<std::int64_t> indefinite(const Stack& matrices) {
  require(
      matrices.shape(1) == matrices.shape(2) && (matrices.shape(1) == 3 || matrices.shape(1) == 6),
      "information matrices are 3x3 or 6x6");
  std::vector<std::int64_t> bad;
  {
    nb::gil_scoped_release release;
    bad = matrices.shape(1) == 3 ? not_positive_definite<3>(matrices.data(), matrices.shape(0))
                                 : not_positive_definite<6>(matrices.data(), matrices.shape(0));
  }
  return as_array(std::move(bad));
}

Topology make_topology(std::int32_t nodes, const Table<std::int32_t>& edges) {
  require(edges.shape(1) == 2, "edges must be (m, 2)");
  require(edges.shape(0) < (std::size_t{1} << 30), "more than 2^30 edges");
  const std::int32_t* const p = edges.data();
  nb::gil_scoped_release release;
  std::vector<Edge> list(edges.shape(0));
  for (std::size_t k = 0; k < list.size(); ++k) {
    list[k] = {p[2 * k], p[2 * k + 1]};
    require(list[k].from >= 0 && list[k].from < nodes && list[k].to >= 0 && list[k].to < nodes,
            "edge index out of range");
  }
  return Topology(nodes, std::move(list));
}

void check_poses(const Topology& graph, const Table<double>& measurements,
                 const Table<double>& poses) {
  require(measurements.shape(0) == graph.edges().size() &&
              poses.shape(0) == static_cast<std::size_t>(graph.nodes()) &&
              poses.shape(1) == measurements.shape(1),
          "measurements must be (m, k), poses (n, k)");
}

void check_roots(const Topology& graph, std::span<const std::int32_t> roots) {
  for (const std::int32_t r : roots) require(r >= 0 && r < graph.nodes(), "root out of range");
}

// Walks the graph with `place(group, out)`, starting from a copy of `poses`.
template <class F>
Array<double> placed(const Table<double>& poses, F place) {
  std::vector<double> out(poses.data(), poses.data() + poses.size());
  {
    nb::gil_scoped_release release;
    with_group(poses.shape(1), [&](auto* group) { place(group, out.data()); });
  }
  return as_array(std::move(out), {poses.shape(0), poses.shape(1)});
}

std::vector<TreeLink> tree(const Topology& graph, const Vector<std::int32_t>& roots,
                           const Vector<bool>& preferred) {
  check_roots(graph, span_of(roots));
  require(preferred.shape(0) == 0 || preferred.shape(0) == graph.edges().size(),
          "preferred must be empty or have an entry an edge");
  return graph.tree(span_of(roots), span_of(preferred));
}

nb::tuple tree_placement(const Topology& graph, const Vector<std::int32_t>& roots,
                         const Vector<bool>& preferred, const Table<double>& measurements,
                         const Table<double>& poses) {
  check_poses(graph, measurements, poses);
  std::vector<TreeLink> links;
  std::vector<std::int32_t> used;
  auto out = placed(poses, [&]<class Group>(Group*, double* p) {
    links = tree(graph, roots, preferred);
    for (const TreeLink& link : links) {
      if (link.edge >= 0) used.push_back(link.edge);
    }
    place_along_tree<Group>(graph, links, measurements.data(), p);
  });
  return nb::make_tuple(out, as_array(std::move(used)));
}

// Walks from the roots with `walk(group, roots, measurements, out)`.
template <class F>
Array<double> walked(const Topology& graph, const Vector<std::int32_t>& roots,
                     const Table<double>& measurements, const Table<double>& poses, F walk) {
  check_roots(graph, span_of(roots));
  check_poses(graph, measurements, poses);
  return placed(
      poses, [&](auto* group, double* p) { walk(group, span_of(roots), measurements.data(), p); });
}

Array<double> masat_placement(const Topology& graph, const Vector<std::int32_t>& roots,
                              const Table<double>& measurements, const Table<double>& poses) {
  return walked(graph, roots, measurements, poses, [&]<class Group>(Group*, auto... arguments) {
    place_by_masat<Group>(graph, arguments...);
  });
}

Array<double> surest_first_placement(const Topology& graph, const Vector<std::int32_t>& roots,
                                     const Table<double>& measurements,
                                     const Table<double>& poses) {
  return walked(graph, roots, measurements, poses, [&]<class Group>(Group*, auto... arguments) {
    place_surest_first<Group>(graph, arguments...);
  });
}

std::shared_ptr<Elimination> make_elimination(const Topology& graph, const Vector<bool>& held,
                                              const Vector<std::int32_t>& order) {
  require(held.shape(0) == static_cast<std::size_t>(graph.nodes()), "one flag a node");
  std::vector<bool> seen(order.shape(0));
  for (const std::int32_t k : span_of(order)) {
    require(k >= 0 && static_cast<std::size_t>(k) < seen.size() && !seen[k],
            "the order must be a permutation");
    seen[k] = true;
  }
  const auto free = std::count(held.data(), held.data() + held.shape(0), false);
  require(seen.empty() || static_cast<std::ptrdiff_t>(seen.size()) == free,
          "the order must name each free node once");
  nb::gil_scoped_release release;
  return std::make_shared<Elimination>(graph, span_of(held), span_of(order));
}

// Compressed rows: the neighbours of each free node, by their places.
nb::tuple adjacency_of(const Elimination& elimination) {
  std::vector<std::int64_t> start{0};
  std::vector<std::int32_t> neighbours;
  for (std::int32_t k = 0; k < elimination.adjacency().nodes(); ++k) {
    for (const auto& neighbour : elimination.adjacency().neighbours(k)) {
      neighbours.push_back(neighbour.node);
    }
    start.push_back(static_cast<std::int64_t>(neighbours.size()));
  }
  return nb::make_tuple(as_array(std::move(start)), as_array(std::move(neighbours)));
}

std::unique_ptr<GraphMatrix> make_matrix(std::shared_ptr<Elimination> elimination, int block_size,
                                         int threads) {
  require(block_size >= 1 && block_size <= kLargestBlock, "blocks have 1 to 10 rows");
  nb::gil_scoped_release release;
  return std::make_unique<GraphMatrix>(std::move(elimination), block_size, threads);
}

Array<double> assembled(GraphMatrix& matrix, const Topology& graph, const Stack& first,
                        const Stack& joint, const Stack& second, const Stack& values) {
  const std::size_t d = matrix.block_size(), columns = values.shape(2);
  for (const Stack* blocks : {&first, &joint, &second}) {
    require(
        blocks->shape(0) == graph.edges().size() && blocks->shape(1) == d && blocks->shape(2) == d,
        "the blocks of the edges must be (m, d, d)");
  }
  require(graph.nodes() == matrix.elimination()->nodes() &&
              static_cast<std::int64_t>(graph.edges().size()) == matrix.elimination()->edges(),
          "the elimination must be of the same graph");
  require(values.shape(0) == static_cast<std::size_t>(graph.nodes()) && values.shape(1) == d,
          "values must be (n, d, k)");
  std::vector<double> forcing(matrix.rows() * columns);
  {
    nb::gil_scoped_release release;
    matrix.assemble(graph, first.data(), joint.data(), second.data(), values.data(),
                    static_cast<int>(columns), forcing.data());
  }
  return as_array(std::move(forcing), {matrix.rows() / d, d, columns});
}

void check_rows(const GraphMatrix& matrix, const Stack& v) {
  const std::size_t d = matrix.block_size();
  require(v.shape(0) * d == static_cast<std::size_t>(matrix.rows()) && v.shape(1) == d,
          "a table must be (free nodes, d, k)");
}

// A copy of v, changed without the interpreter lock.
template <class F>
Array<double> changed(const GraphMatrix& matrix, const Stack& v, F change) {
  check_rows(matrix, v);
  std::vector<double> out(v.data(), v.data() + v.size());
  {
    nb::gil_scoped_release release;
    change(out, static_cast<int>(v.shape(2)));
  }
  return as_array(std::move(out), {v.shape(0), v.shape(1), v.shape(2)});
}

Array<double> toro_placement(const Topology& graph, const Vector<std::int32_t>& roots,
                             const Table<double>& measurements, const Stack& information,
                             const Table<double>& poses, int sweeps) {
  check_roots(graph, span_of(roots));
  check_poses(graph, measurements, poses);
  require(sweeps >= 0, "sweeps must not be negative");
  return placed(poses, [&]<class Group>(Group*, double* p) {
    require(information.shape(0) == graph.edges().size() && information.shape(1) == Group::kDof &&
                information.shape(2) == Group::kDof,
            "information must be (m, d, d)");
    place_by_toro<Group>(graph, span_of(roots), measurements.data(), information.data(), sweeps, p);
  });
}

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
  } else if (matrix.block_size() == 3 && rank == 3) {
    call.template operator()<2, 3>();
  } else if (matrix.block_size() == 3 && rank == 4) {
    call.template operator()<2, 4>();
  } else if (matrix.block_size() == 4 && rank == 3) {
    call.template operator()<3, 3>();
  } else {
    require(matrix.block_size() == 4 && rank == 4, "ranks are 2 to 4 in 2D, 3 and 4 in 3D");
    call.template operator()<3, 4>();
  }
}

nb::tuple minimise_lifted(const GraphMatrix& matrix, const Stack& forcing, double constant,
                          const Stack& start, double decrease, double damping, int steps) {
  std::vector<double> x(start.data(), start.data() + start.size());
  LiftedOutcome outcome;
  with_lifted(matrix, forcing, constant, start, [&](auto problem) {
    const nb::gil_scoped_release release;
    outcome = problem.minimise(x, {decrease, damping, steps});
  });
  return nb::make_tuple(as_array(std::move(x), {start.shape(0), start.shape(1), start.shape(2)}),
                        outcome.cost, outcome.steps, outcome.converged);
}

double lifted_gap(const GraphMatrix& matrix, const Stack& forcing, double constant, const Stack& x,
                  double shift) {
  double gap = 0;
  with_lifted(matrix, forcing, constant, x, [&](auto problem) {
    const nb::gil_scoped_release release;
    gap = problem.gap({x.data(), x.data() + x.size()}, shift);
  });
  return gap;
}

// The poses, and -1 or the node whose translation is not determined.
nb::tuple settled(const Topology& graph, std::shared_ptr<Elimination> elimination,
                  const Table<double>& measurements, const Stack& information,
                  const Table<double>& poses) {
  check_poses(graph, measurements, poses);
  std::int32_t broken = -1;
  auto out = placed(poses, [&]<class Group>(Group*, double* p) {
    require(information.shape(0) == graph.edges().size() && information.shape(1) == Group::kDof &&
                information.shape(2) == Group::kDof,
            "information must be (m, d, d)");
    broken = settle_translations<Group>(graph, std::move(elimination), measurements.data(),
                                        information.data(), p);
  });
  return nb::make_tuple(out, broken);
}

std::unique_ptr<NormalEquations> make_equations(const Topology& graph,
                                                std::shared_ptr<Elimination> elimination,
                                                const Table<double>& measurements,
                                                const Stack& information, int threads) {
  const std::size_t m = graph.edges().size();
  require(measurements.shape(0) == m && information.shape(0) == m, "one row an edge");
  require(
      elimination->nodes() == graph.nodes() && elimination->edges() == static_cast<std::int64_t>(m),
      "the elimination must be of the same graph");
  nb::gil_scoped_release release;
  return with_group(
      measurements.shape(1), [&]<class Group>(Group*) -> std::unique_ptr<NormalEquations> {
        require(information.shape(1) == Group::kDof && information.shape(2) == Group::kDof,
                "information must be (m, d, d)");
        return std::make_unique<NormalEquationsOf<Group>>(
            graph, std::move(elimination), measurements.data(), information.data(), threads);
      });
}

const double* check_poses(const NormalEquations& equations, const Table<double>& poses) {
  require(poses.shape(0) == static_cast<std::size_t>(equations.nodes()) &&
              poses.shape(1) == static_cast<std::size_t>(equations.pose_size()),
          "poses must be (n, 3) or (n, 7)");
  return poses.data();
}

std::size_t unknowns(const NormalEquations& e) { return e.free_nodes().size() * e.dof(); }

Array<double> edge_chi2(NormalEquations& equations, const Table<double>& poses) {
  const double* const p = check_poses(equations, poses);
  std::vector<double> out(equations.edges());
  {
    nb::gil_scoped_release release;
    equations.edge_chi2(p, out.data());
  }
  return as_array(std::move(out));
}

Array<double> step_of(NormalEquations& equations) {
  std::vector<double> step(unknowns(equations));
  {
    nb::gil_scoped_release release;
    equations.solve(step.data());
  }
  return as_array(std::move(step));
}

Array<double> inverse_of(const NormalEquations& equations, const Vector<std::int32_t>& rows,
                         const Vector<std::int32_t>& columns) {
  require(rows.shape(0) == columns.shape(0), "as many rows as columns");
  const auto free = static_cast<std::int32_t>(equations.free_nodes().size());
  for (const auto& places : {span_of(rows), span_of(columns)}) {
    for (const std::int32_t k : places) require(k >= 0 && k < free, "block out of range");
  }
  const std::size_t d = equations.dof();
  std::vector<double> out(rows.shape(0) * d * d);
  {
    nb::gil_scoped_release release;
    equations.inverse(span_of(rows), span_of(columns), out.data());
  }
  return as_array(std::move(out), {rows.shape(0), d, d});
}

Array<double> moved(const NormalEquations& equations, const Table<double>& poses,
                    const Vector<double>& step) {
  const double* const p = check_poses(equations, poses);
  require(step.shape(0) == unknowns(equations), "the step must have an entry an unknown");
  std::vector<double> out(poses.size());
  {
    nb::gil_scoped_release release;
    equations.retract(p, step.data(), out.data());
  }
  return as_array(std::move(out), {poses.shape(0), poses.shape(1)});
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

nb::dict parse_text(const nb::bytes& text, const std::vector<Record>& records) {
  ParsedGraph g;
  {
    const std::string_view view(text.c_str(), text.size());
    nb::gil_scoped_release release;
    g = parse(view, records);
  }
  const std::size_t n = g.vertex_ids.size(), m = g.edge_lines.size();
  const std::size_t size = g.dimension == 2 ? 3 : 7, dof = g.dimension == 2 ? 3 : 6;
  nb::dict unknown;
  for (const UnknownTag& u : g.unknown) {
    unknown[nb::bytes(u.tag.data(), u.tag.size())] = nb::make_tuple(u.count, u.first_line);
  }
  nb::dict out;
  out["dimension"] = g.dimension;
  out["vertex_ids"] = as_array(std::move(g.vertex_ids));
  out["vertex_lines"] = as_array(std::move(g.vertex_lines));
  out["vertex_poses"] = as_array(std::move(g.vertex_poses), {n, size});
  out["edge_ids"] = as_array(std::move(g.edge_ids), {m, 2});
  out["edge_lines"] = as_array(std::move(g.edge_lines));
  out["measurements"] = as_array(std::move(g.measurements), {m, size});
  out["information"] = as_array(std::move(g.information), {m, dof, dof});
  out["fixed_ids"] = as_array(std::move(g.fixed_ids));
  out["fixed_lines"] = as_array(std::move(g.fixed_lines));
  out["unknown"] = unknown;
  out["edges_without_information"] = g.edges_without_information;
  return out;
}

nb::dict tags_of(const nb::bytes& text) {
  nb::dict out;
  for (const auto& [tag, count] : count_tags({text.c_str(), text.size()})) {
    out[nb::bytes(tag.data(), tag.size())] = count;
  }
  return out;
}

nb::bytes formatted(const std::string& tag, const Table<std::int64_t>& integers,
                    const Table<double>& values) {
  require(integers.shape(0) == values.shape(0), "as many rows of integers as of values");
  std::string out;
  {
    nb::gil_scoped_release release;
    out = format_lines(tag, integers.data(), integers.shape(1), values.data(), values.shape(1),
                       values.shape(0));
  }
  return nb::bytes(out.data(), out.size());
}

}  // namespace
}  // namespace masat

NB_MODULE(_core, m) {
  using namespace masat;

  // Tables of records live as long as the interpreter: no leak to warn of.
  nb::set_leak_warnings(false);

  static PyObject* parse_error = PyErr_NewException("masat._core.ParseError", nullptr, nullptr);
  m.attr("ParseError") = nb::borrow(parse_error);
  nb::register_exception_translator([](const std::exception_ptr& p, void*) {
    try {
      std::rethrow_exception(p);
    } catch (const ParseError& e) {
      PyErr_SetObject(parse_error, nb::make_tuple(e.line, e.what()).ptr());
    }
  });

  m.def("compose", &compose, "a"_a, "b"_a);
  m.def("inverse", &inverse, "a"_a);
  m.def("retract", &retract, "a"_a, "step"_a);
  m.def("local", &local, "a"_a, "b"_a);
  m.def("rotation_matrices", &rotations_of, "poses"_a);
  m.def("nearest_rotations", &nearest_rotations, "matrices"_a);
  m.def("indefinite", &indefinite, "matrices"_a);

  nb::class_<Topology>(m, "Topology")
      .def(
          "__init__",
          [](Topology* self, std::int32_t nodes, const Table<std::int32_t>& edges) {
            new (self) Topology(make_topology(nodes, edges));
          },
          "nodes"_a, "edges"_a)
      .def("components", [](const Topology& t) { return as_array(t.components()); });
  m.def("place_along_tree", &tree_placement, "topology"_a, "roots"_a, "preferred"_a,
        "measurements"_a, "poses"_a);
  m.def("place_by_masat", &masat_placement, "topology"_a, "roots"_a, "measurements"_a, "poses"_a);
  m.def("place_surest_first", &surest_first_placement, "topology"_a, "roots"_a, "measurements"_a,
        "poses"_a);
  m.def("place_by_toro", &toro_placement, "topology"_a, "roots"_a, "measurements"_a,
        "information"_a, "poses"_a, "sweeps"_a);

  nb::class_<Elimination>(m, "Elimination")
      .def(nb::new_(&make_elimination), "topology"_a, "held"_a, "order"_a)
      .def("free_nodes",
           [](const Elimination& e) {
             return as_array(
                 std::vector<std::int32_t>(e.free_nodes().begin(), e.free_nodes().end()));
           })
      .def("adjacency", &adjacency_of)
      .def("fill", &Elimination::fill, "block_size"_a)
      .def("operations", &Elimination::operations, "block_size"_a);

  nb::class_<GraphMatrix>(m, "GraphMatrix")
      .def(nb::new_(&make_matrix), "elimination"_a, "block_size"_a, "threads"_a = 1)
      .def("assemble", &assembled, "topology"_a, "first"_a, "joint"_a, "second"_a, "values"_a)
      .def(
          "factorize",
          [](GraphMatrix& matrix, const Vector<double>& damping) {
            require(damping.shape(0) == static_cast<std::size_t>(matrix.rows()),
                    "damping must have an entry a row");
            nb::gil_scoped_release release;
            return matrix.factorize(span_of(damping));
          },
          "damping"_a)
      .def(
          "multiply",
          [](const GraphMatrix& matrix, const Stack& v) {
            return changed(matrix, v, [&](std::vector<double>& out, int columns) {
              matrix.multiply(v.data(), columns, out.data());
            });
          },
          "v"_a)
      .def(
          "solve",
          [](const GraphMatrix& matrix, const Stack& rhs) {
            return changed(matrix, rhs, [&](std::vector<double>& out, int columns) {
              matrix.solve(out, columns);
            });
          },
          "rhs"_a);

  m.def("minimise_lifted", &minimise_lifted, "matrix"_a, "forcing"_a, "constant"_a, "start"_a,
        "decrease"_a, "damping"_a, "steps"_a);
  m.def("lifted_gap", &lifted_gap, "matrix"_a, "forcing"_a, "constant"_a, "x"_a, "shift"_a);
  m.def("settle_translations", &settled, "topology"_a, "elimination"_a, "measurements"_a,
        "information"_a, "poses"_a);

  nb::class_<NormalEquations>(m, "NormalEquations")
      .def(nb::new_(&make_equations), "topology"_a, "elimination"_a, "measurements"_a,
           "information"_a, "threads"_a = 1)
      .def(
          "chi2",
          [](NormalEquations& e, const Table<double>& poses) {
            const double* const p = check_poses(e, poses);
            nb::gil_scoped_release release;
            return e.chi2(p);
          },
          "poses"_a)
      .def("edge_chi2", &edge_chi2, "poses"_a)
      .def(
          "linearize",
          [](NormalEquations& e, const Table<double>& poses,
             const std::optional<Vector<double>>& weights) {
            const double* const p = check_poses(e, poses);
            std::span<const double> w;
            if (weights) {
              w = span_of(*weights);
              require(w.size() == static_cast<std::size_t>(e.edges()), "one weight an edge");
            }
            nb::gil_scoped_release release;
            return e.linearize(p, w);
          },
          "poses"_a, "weights"_a = nb::none())
      .def("rhs",
           [](const NormalEquations& e) {
             return as_array(std::vector<double>(e.rhs().begin(), e.rhs().end()));
           })
      .def("diagonal",
           [](const NormalEquations& e) {
             std::vector<double> out(unknowns(e));
             e.diagonal(out.data());
             return as_array(std::move(out));
           })
      .def(
          "multiply",
          [](const NormalEquations& e, const Vector<double>& v) {
            require(v.shape(0) == unknowns(e), "the vector must have an entry an unknown");
            std::vector<double> out(unknowns(e));
            {
              nb::gil_scoped_release release;
              e.multiply(v.data(), out.data());
            }
            return as_array(std::move(out));
          },
          "v"_a)
      .def(
          "factorize",
          [](NormalEquations& e, const Vector<double>& damping) {
            require(damping.shape(0) == unknowns(e), "damping must have an entry an unknown");
            nb::gil_scoped_release release;
            return e.factorize(span_of(damping));
          },
          "damping"_a)
      .def("solve", &step_of)
      .def("inverse", &inverse_of, "rows"_a, "columns"_a)
      .def("retract", &moved, "poses"_a, "step"_a);

  nb::enum_<Kind>(m, "Kind")
      .value("VERTEX", Kind::kVertex)
      .value("EDGE", Kind::kEdge)
      .value("FIX", Kind::kFix)
      .value("POSE", Kind::kPose);
  nb::enum_<PoseText>(m, "PoseText")
      .value("XY_THETA", PoseText::kXYTheta)
      .value("XYZ_QUATERNION", PoseText::kXYZQuat)
      .value("XYZ_RPY", PoseText::kXYZRPY);
  nb::enum_<InformationText>(m, "InformationText")
      .value("UPPER", InformationText::kUpper)
      .value("TORO_PLANAR", InformationText::kToroPlanar)
      .value("SQUARE_ROOT", InformationText::kSquareRoot)
      .value("COVARIANCE", InformationText::kCovariance);
  nb::class_<Record>(m, "Record")
      .def(nb::init<std::string, Kind, PoseText, InformationText, bool>(), "tag"_a, "kind"_a,
           "pose"_a = PoseText::kXYTheta, "information"_a = InformationText::kUpper,
           "information_optional"_a = false)
      .def_ro("tag", &Record::tag)
      .def_ro("kind", &Record::kind);
  m.def("parse", &parse_text, "text"_a, "records"_a);
  m.def("count_tags", &tags_of, "text"_a);
  m.def("format_lines", &formatted, "tag"_a, "integers"_a, "values"_a);
}
