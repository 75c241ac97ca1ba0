// Reading and writing text by tables of records.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstddef>
#include <cstdint>
#include <exception>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "bindings/bindings.hpp"
#include "text/records.hpp"

namespace masat {
namespace {

using namespace nb::literals;

// A list of bytes, or None if there are none.
nb::object as_list(const std::vector<std::string>& texts) {
  if (texts.empty()) return nb::none();
  nb::list out;
  for (const std::string& text : texts) out.append(nb::bytes(text.data(), text.size()));
  return out;
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
  out["vertex_ids"] = as_array(std::move(g.vertex_ids));
  out["vertex_lines"] = as_array(std::move(g.vertex_lines));
  out["vertex_poses"] = as_array(std::move(g.vertex_poses), {n, size});
  out["vertex_stamps"] = as_list(g.vertex_stamps);
  out["edge_ids"] = as_array(std::move(g.edge_ids), {m, 2});
  out["edge_lines"] = as_array(std::move(g.edge_lines));
  out["measurements"] = as_array(std::move(g.measurements), {m, size});
  out["information"] = as_array(std::move(g.information), {m, dof, dof});
  out["edge_labels"] = as_list(g.edge_labels);
  const std::size_t d = g.dimension == 2 ? 2 : 3;
  const std::size_t priors = g.prior_lines.size(), seen = g.observation_lines.size();
  out["prior_ids"] = as_array(std::move(g.prior_ids));
  out["prior_lines"] = as_array(std::move(g.prior_lines));
  out["prior_parameters"] = as_array(std::move(g.prior_parameters));
  out["priors"] = as_array(std::move(g.priors), {priors, size});
  out["prior_information"] = as_array(std::move(g.prior_information), {priors, dof, dof});
  const std::size_t points = g.point_lines.size(), parameters = g.parameter_lines.size();
  out["point_ids"] = as_array(std::move(g.point_ids));
  out["point_lines"] = as_array(std::move(g.point_lines));
  out["points"] = as_array(std::move(g.points), {points, d});
  out["observation_ids"] = as_array(std::move(g.observation_ids), {seen, 2});
  out["observation_lines"] = as_array(std::move(g.observation_lines));
  out["observation_parameters"] = as_array(std::move(g.observation_parameters));
  out["observations"] = as_array(std::move(g.observations), {seen, d});
  out["observation_information"] = as_array(std::move(g.observation_information), {seen, d, d});
  out["observation_range_bearing"] = as_array(std::move(g.observation_range_bearing));
  out["parameter_ids"] = as_array(std::move(g.parameter_ids));
  out["parameter_lines"] = as_array(std::move(g.parameter_lines));
  out["parameters"] = as_array(std::move(g.parameters), {parameters, size});
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
                    const Table<double>& values, const std::vector<std::string>& labels,
                    const std::string& name) {
  require(integers.shape(0) == values.shape(0), "as many rows of integers as of values");
  require(labels.empty() || labels.size() == values.shape(0), "as many labels as rows");
  std::string out;
  {
    nb::gil_scoped_release release;
    out = format_lines(tag, integers.data(), integers.shape(1), values.data(), values.shape(1),
                       values.shape(0), labels, name);
  }
  return nb::bytes(out.data(), out.size());
}

}  // namespace

void bind_text(nb::module_& m) {
  static PyObject* parse_error = PyErr_NewException("masat._core.ParseError", nullptr, nullptr);
  m.attr("ParseError") = nb::borrow(parse_error);
  nb::register_exception_translator([](const std::exception_ptr& p, void*) {
    try {
      std::rethrow_exception(p);
    } catch (const ParseError& e) {
      PyErr_SetObject(parse_error, nb::make_tuple(e.line, e.what()).ptr());
    }
  });

  nb::enum_<Kind>(m, "Kind")
      .value("VERTEX", Kind::kVertex)
      .value("EDGE", Kind::kEdge)
      .value("FIX", Kind::kFix)
      .value("POSE", Kind::kPose)
      .value("STAMPED_POSE", Kind::kStampedPose)
      .value("PRIOR", Kind::kPrior)
      .value("POINT", Kind::kPoint)
      .value("OBSERVATION", Kind::kObservation)
      .value("PARAMETER", Kind::kParameter);
  nb::enum_<PoseText>(m, "PoseText")
      .value("XY_THETA", PoseText::kXYTheta)
      .value("XYZ_QUATERNION", PoseText::kXYZQuat)
      .value("XYZ_RPY", PoseText::kXYZRPY)
      .value("MATRIX", PoseText::kMatrix)
      .value("XY", PoseText::kXY)
      .value("XYZ", PoseText::kXYZ)
      .value("BEARING", PoseText::kBearing)
      .value("RANGE_BEARING", PoseText::kRangeBearing)
      .value("RANGE_BEARING_ELEVATION", PoseText::kRangeBearingElevation);
  nb::enum_<InformationText>(m, "InformationText")
      .value("UPPER", InformationText::kUpper)
      .value("TORO_PLANAR", InformationText::kToroPlanar)
      .value("SQUARE_ROOT", InformationText::kSquareRoot)
      .value("COVARIANCE", InformationText::kCovariance);
  nb::class_<Record>(m, "Record")
      .def(nb::init<std::string, Kind, PoseText, InformationText, bool, bool>(), "tag"_a, "kind"_a,
           "pose"_a = PoseText::kXYTheta, "information"_a = InformationText::kUpper,
           "information_optional"_a = false, "parameter"_a = false)
      .def_ro("tag", &Record::tag);
  m.def("parse", &parse_text, "text"_a, "records"_a);
  m.def("count_tags", &tags_of, "text"_a);
  m.def("format_lines", &formatted, "tag"_a, "integers"_a, "values"_a,
        "labels"_a = std::vector<std::string>{}, "name"_a = std::string(kLabel));
}

}  // namespace masat
