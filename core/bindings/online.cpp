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

template <class T, class A>
std::vector<T> copied(const A& array) {
  return {array.data(), array.data() + array.size()};
}

// Flags as the core returns them.
Array<bool> as_flags(std::vector<std::uint8_t>&& flags) {
  static_assert(sizeof(bool) == 1);
  auto* const owned = new std::vector<std::uint8_t>(std::move(flags));
  nb::capsule owner(owned,
                    [](void* p) noexcept { delete static_cast<std::vector<std::uint8_t>*>(p); });
  return Array<bool>(reinterpret_cast<bool*>(owned->data()), {owned->size()}, owner);
}

bool add_node(OnlineMap& map, std::int64_t id, const std::optional<Vector<double>>& pose,
              bool is_point) {
  if (pose) require(pose->shape(0) == static_cast<std::size_t>(map.pose_size()), "size of a pose");
  return map.add_node(id, pose ? pose->data() : nullptr, is_point);
}

SensorEdges sensor_edges(const OnlineMap& map, const Table<std::int32_t>& ends,
                         const Table<double>& measurements, const Stack& information,
                         const Table<double>& offsets, const Vector<bool>& range_bearing) {
  const std::size_t m = ends.shape(0), s = map.pose_size(), d = map.dof();
  require(ends.shape(1) == 2 && measurements.size() == m * s && information.size() == m * d * d &&
              offsets.size() == m * s && range_bearing.shape(0) == m,
          "one row an edge");
  return {{},
          copied<std::int32_t>(ends),
          copied<double>(measurements),
          copied<double>(information),
          copied<double>(offsets),
          copied<std::uint8_t>(range_bearing)};
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

bool add_sensor_edges(OnlineMap& map, const Table<std::int32_t>& ends,
                      const Table<double>& measurements, const Stack& information,
                      const Table<double>& offsets, const Vector<bool>& range_bearing,
                      const std::optional<Vector<bool>>& may_place,
                      const std::optional<Vector<std::int64_t>>& numbers) {
  SensorEdges edges = sensor_edges(map, ends, measurements, information, offsets, range_bearing);
  const std::size_t m = ends.shape(0);
  require((!may_place || may_place->shape(0) == m) && (!numbers || numbers->shape(0) == m),
          "one flag and one number an edge");
  // They may be on nodes that wait for the next update.
  for (std::size_t k = 0; k < m; ++k) {
    require(edges.ends[2 * k] >= 0 && edges.ends[2 * k + 1] > 0, "node out of range");
  }
  if (numbers) edges.numbers = copied<std::int64_t>(*numbers);
  return map.add_sensor_edges(edges, may_place ? span_of(*may_place) : std::span<const bool>());
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
  SensorEdges& others = c.sensor_edges;
  const std::size_t p = others.numbers.size();
  out["points"] = as_flags(std::move(c.points));
  out["sensor_numbers"] = as_array(std::move(others.numbers));
  out["sensor_ends"] = as_array(std::move(others.ends), {p, 2});
  out["sensor_measurements"] = as_array(std::move(others.measurements), {p, s});
  out["sensor_information"] = as_array(std::move(others.information), {p, d, d});
  out["sensor_offsets"] = as_array(std::move(others.offsets), {p, s});
  out["sensor_range_bearing"] = as_flags(std::move(others.range_bearing));
  out["next_edge"] = c.next_edge;
  return out;
}

void fill(OnlineMap& map, const Vector<std::int64_t>& ids, const Vector<bool>& points,
          const Table<double>& poses, const Table<double>& linearized,
          const Vector<std::int32_t>& roots, const Vector<std::int64_t>& numbers,
          const Table<std::int64_t>& edges, const Table<double>& measurements,
          const Stack& information, const Vector<std::int64_t>& sensor_numbers,
          const Table<std::int32_t>& sensor_ends, const Table<double>& sensor_measurements,
          const Stack& sensor_information, const Table<double>& sensor_offsets,
          const Vector<bool>& sensor_range_bearing, std::int64_t next_edge) {
  const std::size_t n = ids.shape(0), m = numbers.shape(0);
  const std::size_t s = map.pose_size(), d = map.dof();
  SensorEdges others = sensor_edges(map, sensor_ends, sensor_measurements, sensor_information,
                                    sensor_offsets, sensor_range_bearing);
  others.numbers = copied<std::int64_t>(sensor_numbers);
  require(map.nodes() == 1 && points.shape(0) == n && poses.size() == n * s &&
              linearized.size() == n * s && roots.shape(0) == n && edges.size() == 2 * m &&
              measurements.size() == m * s && information.size() == m * d * d &&
              2 * others.numbers.size() == others.ends.size(),
          "contents of a map");
  map.fill({copied<std::int64_t>(ids), copied<std::uint8_t>(points), copied<double>(poses),
            copied<double>(linearized), copied<std::int32_t>(roots), copied<std::int64_t>(numbers),
            copied<std::int64_t>(edges), copied<double>(measurements), copied<double>(information),
            std::move(others), next_edge});
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
      .def("add_node", &add_node, "node"_a, "pose"_a = nb::none(), "is_point"_a = false)
      .def("add_edges", &add_edges, "edges"_a, "measurements"_a, "information"_a,
           "numbers"_a = nb::none())
      .def("add_sensor_edges", &add_sensor_edges, "ends"_a, "measurements"_a, "information"_a,
           "offsets"_a, "range_bearing"_a, "may_place"_a = nb::none(), "numbers"_a = nb::none())
      .def("left_out", [](const OnlineMap& map) { return as_array(map.left_out()); })
      .def(
          "place_point",
          [](OnlineMap& map, std::int32_t node, const Vector<double>& pose) {
            require(node > 0 && node < map.nodes() &&
                        pose.shape(0) == static_cast<std::size_t>(map.pose_size()),
                    "a point of the map");
            map.place_point(node, pose.data());
          },
          "node"_a, "pose"_a)
      .def(
          "is_point",
          [](const OnlineMap& map, std::int64_t id) {
            const std::int32_t node = map.find(id);
            return node > 0 && map.is_point(node);
          },
          "node"_a)
      .def("points", [](const OnlineMap& map) { return as_flags(map.points()); })
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
      .def("has_sensor_edges", &OnlineMap::has_sensor_edges)
      .def("point_count", &OnlineMap::point_count)
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
      .def("fill", &fill, "ids"_a, "points"_a, "poses"_a, "linearized"_a, "roots"_a,
           "edge_numbers"_a, "edges"_a, "measurements"_a, "information"_a, "sensor_numbers"_a,
           "sensor_ends"_a, "sensor_measurements"_a, "sensor_information"_a, "sensor_offsets"_a,
           "sensor_range_bearing"_a, "next_edge"_a);
}

}  // namespace masat
