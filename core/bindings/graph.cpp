// The graph, its residuals, and the initial guesses that walk over it.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "bindings/bindings.hpp"
#include "factors/relative_pose.hpp"
#include "factors/sensor.hpp"
#include "factors/sums.hpp"
#include "graph/topology.hpp"
#include "initializers/placement.hpp"
#include "initializers/toro.hpp"

namespace masat {

void check_poses(const Topology& graph, const Table<double>& measurements,
                 const Table<double>& poses) {
  require(measurements.shape(0) == graph.edges().size() &&
              poses.shape(0) == static_cast<std::size_t>(graph.nodes()) &&
              poses.shape(1) == measurements.shape(1),
          "measurements must be (m, k), poses (n, k)");
}

namespace {

using namespace nb::literals;

Topology make_topology(std::int32_t nodes, const Table<std::int32_t>& edges) {
  require(nodes >= 0, "the number of nodes must not be negative");
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

void check_roots(const Topology& graph, std::span<const std::int32_t> roots) {
  std::vector<bool> seen(graph.nodes());
  for (const std::int32_t r : roots) {
    require(r >= 0 && r < graph.nodes(), "root out of range");
    require(!seen[r], "a node is given as root twice");
    seen[r] = true;
  }
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

Array<double> most_informed_first_placement(const Topology& graph,
                                            const Vector<std::int32_t>& roots,
                                            const Table<double>& measurements,
                                            const Table<double>& poses) {
  return walked(graph, roots, measurements, poses, [&]<class Group>(Group*, auto... arguments) {
    place_most_informed_first<Group>(graph, arguments...);
  });
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

Array<double> residuals_of(const Topology& graph, const Table<double>& measurements,
                           const Table<double>& poses, const std::optional<Table<double>>& offsets,
                           const std::optional<Vector<bool>>& range_bearing) {
  check_poses(graph, measurements, poses);
  const double* const moved = data_of(offsets, measurements.shape(0), poses.shape(1));
  const bool* const flags = flags_of(range_bearing, measurements.shape(0));
  const std::size_t dof = poses.shape(1) == SE2::kSize ? SE2::kDof : SE3::kDof;
  std::vector<double> out(measurements.shape(0) * dof);
  {
    nb::gil_scoped_release release;
    with_group(poses.shape(1), [&]<class Group>(Group*) {
      const typename Group::Table at(poses.data(), graph.nodes());
      if (moved == nullptr && flags == nullptr) {
        residuals(RelativePoseFactors<Group>(graph.edges(), measurements.data()), at, out.data());
      } else {
        residuals(SensorFactors<Group>(graph.edges(), measurements.data(), nullptr, moved, flags),
                  at, out.data());
      }
    });
  }
  return as_array(std::move(out), {measurements.shape(0), dof});
}

Array<double> chi2_of_edges(const Topology& graph, const Table<double>& measurements,
                            const Stack& information, const Table<double>& poses,
                            const std::optional<Table<double>>& offsets,
                            const std::optional<Vector<bool>>& range_bearing) {
  check_poses(graph, measurements, poses);
  const double* const moved = data_of(offsets, measurements.shape(0), poses.shape(1));
  const bool* const flags = flags_of(range_bearing, measurements.shape(0));
  std::vector<double> out(measurements.shape(0));
  with_group(poses.shape(1), [&]<class Group>(Group*) {
    require(information.shape(0) == out.size() && information.shape(1) == Group::kDof &&
                information.shape(2) == Group::kDof,
            "information must be (m, d, d)");
    nb::gil_scoped_release release;
    const typename Group::Table at(poses.data(), graph.nodes());
    if (moved == nullptr && flags == nullptr) {
      costs(RelativePoseFactors<Group>(graph.edges(), measurements.data(), information.data()), at,
            out.data());
    } else {
      costs(SensorFactors<Group>(graph.edges(), measurements.data(), information.data(), moved,
                                 flags),
            at, out.data());
    }
  });
  return as_array(std::move(out));
}

// Errors of points, (k, d), in frames whose x axes point in the measured directions, and their
// derivatives.
template <int d>
nb::tuple range_bearing_errors(const Table<double>& points, const Vector<double>& ranges) {
  const std::size_t n = points.shape(0);
  std::vector<double> errors(n * d), jacobians(n * d * d);
  for (std::size_t k = 0; k < n; ++k) {
    Eigen::Matrix<double, d, d> j;
    Eigen::Map<Eigen::Matrix<double, d, 1>>{&errors[k * d]} = range_bearing_error<d>(
        Eigen::Map<const Eigen::Matrix<double, d, 1>>(points.data() + k * d), ranges.data()[k], &j);
    Eigen::Map<Eigen::Matrix<double, d, d>>{&jacobians[k * d * d]} = j.transpose();
  }
  return nb::make_tuple(as_array(std::move(errors), {n, d}),
                        as_array(std::move(jacobians), {n, d, d}));
}

nb::tuple errors_of_points(const Table<double>& points, const Vector<double>& ranges) {
  const std::size_t d = points.shape(1);
  require((d == 2 || d == 3) && ranges.shape(0) == points.shape(0),
          "points must be (k, 2) or (k, 3), ranges (k,)");
  return d == 2 ? range_bearing_errors<2>(points, ranges) : range_bearing_errors<3>(points, ranges);
}

}  // namespace

void bind_graph(nb::module_& m) {
  nb::class_<Topology>(m, "Topology")
      .def(
          "__init__",
          [](Topology* self, std::int32_t nodes, const Table<std::int32_t>& edges) {
            new (self) Topology(make_topology(nodes, edges));
          },
          "nodes"_a, "edges"_a)
      .def(
          "incident_edges",
          [](const Topology& t, const Vector<bool>& nodes) {
            require(nodes.shape(0) == static_cast<std::size_t>(t.nodes()), "one flag a node");
            return as_array(t.incident_edges(span_of(nodes)));
          },
          "nodes"_a)
      .def("components", [](const Topology& t) { return as_array(t.components()); });
  m.def("residuals", &residuals_of, "topology"_a, "measurements"_a, "poses"_a,
        "offsets"_a = nb::none(), "range_bearing"_a = nb::none());
  m.def("chi2_per_edge", &chi2_of_edges, "topology"_a, "measurements"_a, "information"_a, "poses"_a,
        "offsets"_a = nb::none(), "range_bearing"_a = nb::none());
  m.def("range_bearing_errors", &errors_of_points, "points"_a, "ranges"_a);
  m.def("place_along_tree", &tree_placement, "topology"_a, "roots"_a, "preferred"_a,
        "measurements"_a, "poses"_a);
  m.def("place_by_masat", &masat_placement, "topology"_a, "roots"_a, "measurements"_a, "poses"_a);
  m.def("place_most_informed_first", &most_informed_first_placement, "topology"_a, "roots"_a,
        "measurements"_a, "poses"_a);
  m.def("place_by_toro", &toro_placement, "topology"_a, "roots"_a, "measurements"_a,
        "information"_a, "poses"_a, "sweeps"_a);
}

}  // namespace masat
