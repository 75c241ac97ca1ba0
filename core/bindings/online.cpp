// The map that grows.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/unique_ptr.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "bindings/bindings.hpp"
#include "online/online_map.hpp"

namespace masat {
namespace {

using namespace nb::literals;

bool add_node(OnlineMap& map, std::int64_t id, const std::optional<Vector<double>>& pose) {
  if (pose) require(pose->shape(0) == static_cast<std::size_t>(map.pose_size()), "size of a pose");
  return map.add_node(id, pose ? pose->data() : nullptr);
}

bool add_edges(OnlineMap& map, const Table<std::int64_t>& pairs, const Table<double>& measurements,
               const Stack& information, const std::optional<Vector<std::int64_t>>& numbers) {
  const std::size_t m = pairs.shape(0), d = static_cast<std::size_t>(map.dof());
  require(!numbers || numbers->shape(0) == m, "one number an edge");
  require(pairs.shape(1) == 2 && measurements.shape(0) == m && information.shape(0) == m &&
              measurements.shape(1) == static_cast<std::size_t>(map.pose_size()) &&
              information.shape(1) == d && information.shape(2) == d,
          "one row an edge");
  return map.add_edges({pairs.data(), pairs.size()}, measurements.data(), information.data(),
                       numbers ? numbers->data() : nullptr);
}

bool add_priors(OnlineMap& map, const Vector<std::int32_t>& nodes,
                const Table<double>& measurements, const Stack& information,
                const std::optional<Vector<std::int64_t>>& numbers) {
  const std::size_t m = nodes.shape(0), d = static_cast<std::size_t>(map.dof());
  require(measurements.size() == m * static_cast<std::size_t>(map.pose_size()) &&
              information.size() == m * d * d && (!numbers || numbers->shape(0) == m),
          "one row a prior");
  // They may be on nodes that wait for the next update.
  for (const std::int32_t k : span_of(nodes)) require(k > 0, "node out of range");
  return map.add_priors(span_of(nodes), measurements.data(), information.data(),
                        numbers ? numbers->data() : nullptr);
}

nb::tuple update(OnlineMap& map, double budget) {
  StepSummary s;
  {
    nb::gil_scoped_release release;
    s = map.update(budget);
  }
  return nb::make_tuple(s.chi2, s.refactored, s.relinearized, s.changed, s.passes, s.complete,
                        s.turned);
}

Array<double> poses_of(const OnlineMap& map) {
  std::vector<double> poses;
  {
    nb::gil_scoped_release release;
    poses = map.poses();
  }
  const std::size_t size = map.pose_size(), count = poses.size() / size;
  return as_array(std::move(poses), {count, size});
}

// Reads by index, so that the interpreter lock need not be held.
std::int32_t known(const OnlineMap& map, std::int64_t id) {
  const std::int32_t index = map.find(id);
  return index < map.nodes() ? index : -1;
}

template <void (OnlineMap::*kMethod)(const double*)>
void with_poses(OnlineMap& map, const Table<double>& poses) {
  require(poses.shape(0) + 1 == static_cast<std::size_t>(map.nodes()) &&
              poses.shape(1) == static_cast<std::size_t>(map.pose_size()),
          "poses of all nodes");
  nb::gil_scoped_release release;
  (map.*kMethod)(poses.data());
}

nb::object pose_of(const OnlineMap& map, std::int64_t id) {
  const std::int32_t index = known(map, id);
  if (index < 0) return nb::none();
  std::vector<double> pose(map.pose_size());
  map.pose(index, pose.data());
  return nb::cast(as_array(std::move(pose)));
}

Array<double> covariances(OnlineMap& map, const Vector<std::int32_t>& rows,
                          const Vector<std::int32_t>& columns) {
  require(rows.shape(0) == columns.shape(0), "as many rows as columns");
  const std::size_t d = map.dof();
  std::vector<double> out(rows.shape(0) * d * d);
  {
    nb::gil_scoped_release release;
    for (const auto& indices : {span_of(rows), span_of(columns)}) {
      for (const std::int32_t k : indices) require(k >= 0 && k < map.nodes(), "node out of range");
    }
    map.covariances(span_of(rows), span_of(columns), out.data());
  }
  return as_array(std::move(out), {rows.shape(0), d, d});
}

nb::tuple predict(OnlineMap& map, const Table<std::int32_t>& ends,
                  const Table<double>& measurements, const Stack& information) {
  const std::size_t m = ends.shape(0), d = static_cast<std::size_t>(map.dof());
  require(ends.shape(1) == 2 && measurements.shape(0) == m && information.shape(0) == m &&
              measurements.shape(1) == static_cast<std::size_t>(map.pose_size()) &&
              information.shape(1) == d && information.shape(2) == d,
          "one row an edge");
  const std::span<const std::int32_t> nodes{ends.data(), ends.size()};
  for (const std::int32_t k : nodes) require(k >= 0 && k < map.nodes(), "node out of range");
  std::vector<double> distances(m), log_determinants(m);
  {
    nb::gil_scoped_release release;
    map.predict(nodes, measurements.data(), information.data(), distances.data(),
                log_determinants.data());
  }
  return nb::make_tuple(as_array(std::move(distances)), as_array(std::move(log_determinants)));
}

nb::dict contents_of(const OnlineMap& map) {
  MapContents c;
  {
    nb::gil_scoped_release release;
    c = map.contents();
  }
  const std::size_t n = c.ids.size(), m = c.numbers.size(), s = map.pose_size(), d = map.dof();
  nb::dict out;
  out["ids"] = as_array(std::move(c.ids));
  out["poses"] = as_array(std::move(c.poses), {n, s});
  out["linearized"] = as_array(std::move(c.bases), {n, s});
  out["roots"] = as_array(std::move(c.roots));
  out["edge_numbers"] = as_array(std::move(c.numbers));
  out["edges"] = as_array(std::move(c.pairs), {m, 2});
  out["measurements"] = as_array(std::move(c.measurements), {m, s});
  out["information"] = as_array(std::move(c.information), {m, d, d});
  const std::size_t p = c.prior_numbers.size();
  out["prior_numbers"] = as_array(std::move(c.prior_numbers));
  out["prior_ids"] = as_array(std::move(c.prior_ids));
  out["prior_measurements"] = as_array(std::move(c.prior_measurements), {p, s});
  out["prior_information"] = as_array(std::move(c.prior_information), {p, d, d});
  out["next_edge"] = c.next_edge;
  return out;
}

template <class T, class A>
std::vector<T> copied(const A& array) {
  return {array.data(), array.data() + array.size()};
}

void fill(OnlineMap& map, const Vector<std::int64_t>& ids, const Table<double>& poses,
          const Table<double>& linearized, const Vector<std::int32_t>& roots,
          const Vector<std::int64_t>& numbers, const Table<std::int64_t>& edges,
          const Table<double>& measurements, const Stack& information,
          const Vector<std::int64_t>& prior_numbers, const Vector<std::int64_t>& prior_ids,
          const Table<double>& prior_measurements, const Stack& prior_information,
          std::int64_t next_edge) {
  const std::size_t n = ids.shape(0), m = numbers.shape(0), p = prior_numbers.shape(0);
  const std::size_t s = map.pose_size(), d = map.dof();
  require(map.nodes() == 1 && poses.size() == n * s && linearized.size() == n * s &&
              roots.shape(0) == n && edges.size() == 2 * m && measurements.size() == m * s &&
              information.size() == m * d * d && prior_ids.shape(0) == p &&
              prior_measurements.size() == p * s && prior_information.size() == p * d * d,
          "contents of a map");
  map.fill({copied<std::int64_t>(ids), copied<double>(poses), copied<double>(linearized),
            copied<std::int32_t>(roots), copied<std::int64_t>(numbers), copied<std::int64_t>(edges),
            copied<double>(measurements), copied<double>(information),
            copied<std::int64_t>(prior_numbers), copied<std::int64_t>(prior_ids),
            copied<double>(prior_measurements), copied<double>(prior_information), next_edge});
}

}  // namespace

void bind_online(nb::module_& m) {
  static nb::exception<Undetermined> undetermined(m, "UndeterminedError");
  nb::register_exception_translator([](const std::exception_ptr& p, void*) {
    try {
      std::rethrow_exception(p);
    } catch (const Undetermined& e) {
      PyErr_SetObject(undetermined.ptr(), nb::int_(e.id).ptr());
    }
  });
  nb::class_<OnlineMap>(m, "OnlineMap")
      .def(nb::new_(&make_online_map), "dimension"_a, "tolerance"_a)
      .def("add_node", &add_node, "node"_a, "pose"_a = nb::none())
      .def("add_edges", &add_edges, "edges"_a, "measurements"_a, "information"_a,
           "numbers"_a = nb::none())
      .def("add_priors", &add_priors, "nodes"_a, "measurements"_a, "information"_a,
           "numbers"_a = nb::none())
      .def("roots", [](const OnlineMap& map) { return as_array(map.roots()); })
      .def(
          "remove_edges",
          [](OnlineMap& map, const Vector<std::int64_t>& numbers) {
            return map.remove_edges(span_of(numbers));
          },
          "numbers"_a)
      .def("next_edge", &OnlineMap::next_edge)
      .def("find", &OnlineMap::find, "node"_a)
      .def("update", &update, "budget"_a)
      .def("nodes", &OnlineMap::nodes)
      .def("chi2", &OnlineMap::chi2)
      .def("poses", &poses_of)
      .def("pose", &pose_of, "node"_a)
      .def("edges", &OnlineMap::edges)
      .def("bytes_of_factor", &OnlineMap::bytes_of_factor)
      .def("fill_of_factor", &OnlineMap::fill_of_factor)
      .def("set_poses", &with_poses<&OnlineMap::set_poses>, "poses"_a)
      .def("start_from", &with_poses<&OnlineMap::start_from>, "poses"_a)
      .def("exact_chi2", &OnlineMap::exact_chi2, nb::call_guard<nb::gil_scoped_release>())
      .def("ids", [](const OnlineMap& map) { return as_array(map.ids()); })
      .def("has_edge", &OnlineMap::has_edge, "number"_a)
      .def(
          "find_all",
          [](const OnlineMap& map, const Vector<std::int64_t>& ids) {
            std::vector<std::int32_t> indices;
            for (const std::int64_t id : span_of(ids)) indices.push_back(known(map, id));
            return as_array(std::move(indices));
          },
          "ids"_a)
      .def(
          "linearized",
          [](const OnlineMap& map, const Vector<std::int32_t>& nodes) {
            for (const std::int32_t k : span_of(nodes)) {
              require(k >= 0 && k < map.nodes(), "node out of range");
            }
            const std::size_t count = nodes.shape(0), size = map.pose_size();
            std::vector<double> out(count * size);
            map.linearized(span_of(nodes), out.data());
            return as_array(std::move(out), {count, size});
          },
          "nodes"_a)
      .def("covariances", &covariances, "rows"_a, "columns"_a)
      .def("predict", &predict, "ends"_a, "measurements"_a, "information"_a)
      .def(
          "edge_chi2",
          [](const OnlineMap& map, const Vector<std::int64_t>& numbers) {
            for (const std::int64_t k : span_of(numbers)) {
              require(map.has_edge(k), "edge out of range");
            }
            std::vector<double> out(numbers.shape(0));
            map.edge_chi2(span_of(numbers), out.data());
            return as_array(std::move(out));
          },
          "numbers"_a)
      .def("contents", &contents_of)
      .def("fill", &fill, "ids"_a, "poses"_a, "linearized"_a, "roots"_a, "edge_numbers"_a,
           "edges"_a, "measurements"_a, "information"_a, "prior_numbers"_a, "prior_ids"_a,
           "prior_measurements"_a, "prior_information"_a, "next_edge"_a);
}

}  // namespace masat
