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
               const Stack& information) {
  const std::size_t m = pairs.shape(0), d = static_cast<std::size_t>(map.dof());
  require(pairs.shape(1) == 2 && measurements.shape(0) == m && information.shape(0) == m &&
              measurements.shape(1) == static_cast<std::size_t>(map.pose_size()) &&
              information.shape(1) == d && information.shape(2) == d,
          "one row an edge");
  return map.add_edges({pairs.data(), pairs.size()}, measurements.data(), information.data());
}

nb::tuple update(OnlineMap& map, double budget) {
  StepSummary s;
  {
    nb::gil_scoped_release release;
    s = map.update(budget);
  }
  return nb::make_tuple(s.chi2, s.refactored, s.relinearized, s.changed, s.passes, s.complete);
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
      .def("add_node", &add_node, "id"_a, "pose"_a = nb::none())
      .def("add_edges", &add_edges, "edges"_a, "measurements"_a, "information"_a)
      .def(
          "remove_edges",
          [](OnlineMap& map, const Vector<std::int64_t>& numbers) {
            return map.remove_edges(span_of(numbers));
          },
          "numbers"_a)
      .def("next_edge", &OnlineMap::next_edge)
      .def("find", &OnlineMap::find, "id"_a)
      .def("update", &update, "budget"_a)
      .def("nodes", &OnlineMap::nodes)
      .def("chi2", &OnlineMap::chi2)
      .def("poses", &poses_of);
}

}  // namespace masat
