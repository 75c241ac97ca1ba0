// The normal equations of the optimizers.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/unique_ptr.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "bindings/bindings.hpp"
#include "bindings/parts.hpp"
#include "factors/loss.hpp"
#include "graph/topology.hpp"
#include "optimizers/normal_equations.hpp"

namespace masat {
namespace {

using namespace nb::literals;

// Keeps alive what the equations refer to.
template <class Group>
class EquationsOfArrays final : public NormalEquationsOf<Group> {
 public:
  EquationsOfArrays(nb::object topology, std::shared_ptr<Elimination> elimination,
                    const Table<double>& measurements, const Stack& information, int threads)
      : NormalEquationsOf<Group>(
            RelativePoseFactors<Group>(nb::inst_ptr<Topology>(topology)->edges(),
                                       measurements.data(), information.data()),
            std::move(elimination), threads),
        topology_(std::move(topology)),
        measurements_(measurements),
        information_(information) {}

 private:
  nb::object topology_;
  Table<double> measurements_;
  Stack information_;
};

std::unique_ptr<NormalEquations> make_equations(nb::handle_t<Topology> topology,
                                                std::shared_ptr<Elimination> elimination,
                                                const Table<double>& measurements,
                                                const Stack& information, int threads,
                                                const std::optional<Table<double>>& offsets,
                                                const std::optional<Vector<bool>>& range_bearing) {
  const Topology& graph = *nb::inst_ptr<Topology>(topology);
  const std::size_t m = graph.edges().size();
  require(measurements.shape(0) == m && information.shape(0) == m, "one row an edge");
  // That of a part has further edges, to its elements.
  require(
      elimination->nodes() == graph.nodes() && elimination->edges() >= static_cast<std::int64_t>(m),
      "the elimination must be of the same graph");
  nb::object owner = nb::borrow(topology);
  if (offsets || range_bearing) {
    return sensor_equations(std::move(owner), std::move(elimination), measurements, information,
                            offsets, range_bearing, threads);
  }
  nb::gil_scoped_release release;
  return with_group(
      measurements.shape(1), [&]<class Group>(Group*) -> std::unique_ptr<NormalEquations> {
        require(information.shape(1) == Group::kDof && information.shape(2) == Group::kDof,
                "information must be (m, d, d)");
        return std::make_unique<EquationsOfArrays<Group>>(std::move(owner), std::move(elimination),
                                                          measurements, information, threads);
      });
}

const double* check_poses(const NormalEquations& equations, const Table<double>& poses) {
  require(poses.shape(0) == static_cast<std::size_t>(equations.nodes()) &&
              poses.shape(1) == static_cast<std::size_t>(equations.pose_size()),
          "poses must be (n, 3) or (n, 7)");
  return poses.data();
}

Array<double> step_of(NormalEquations& equations) {
  std::vector<double> step(rows_of(equations));
  {
    nb::gil_scoped_release release;
    equations.solve(step.data());
  }
  return as_array(std::move(step));
}

Array<double> moved(const NormalEquations& equations, const Table<double>& poses,
                    const Vector<double>& step) {
  const double* const p = check_poses(equations, poses);
  require(step.shape(0) == rows_of(equations), "the step must have an entry an unknown");
  std::vector<double> out(poses.size());
  {
    nb::gil_scoped_release release;
    equations.retract(p, step.data(), out.data());
  }
  return as_array(std::move(out), {poses.shape(0), poses.shape(1)});
}

std::span<const bool> mask_of(const NormalEquations& equations,
                              const std::optional<Vector<bool>>& trusted) {
  if (!trusted) return {};
  require(trusted->shape(0) == static_cast<std::size_t>(equations.factors()), "one flag an edge");
  return span_of(*trusted);
}

nb::tuple values_of(const Loss& loss, const Vector<double>& chi2) {
  std::vector<double> costs, weights;
  costs.reserve(chi2.size());
  weights.reserve(chi2.size());
  for (const double c : span_of(chi2)) {
    const LossValue value = loss(c);
    costs.push_back(value.cost);
    weights.push_back(value.weight);
  }
  return nb::make_tuple(as_array(std::move(costs)), as_array(std::move(weights)));
}

void bind_losses(nb::module_& m) {
  nb::enum_<LossKind>(m, "LossKind")
      .value("CAUCHY", LossKind::kCauchy)
      .value("GEMAN_MCCLURE", LossKind::kGemanMcClure)
      .value("HUBER", LossKind::kHuber)
      .value("TUKEY", LossKind::kTukey)
      .value("DCS", LossKind::kDcs)
      .value("TRUNCATED", LossKind::kTruncated);
  nb::class_<Loss>(m, "Loss")
      .def(nb::init<LossKind, double, double>(), "kind"_a, "scale"_a,
           "mu"_a = std::numeric_limits<double>::infinity())
      .def("__call__", &values_of, "chi2"_a);
}

}  // namespace

void bind_equations(nb::module_& m) {
  bind_losses(m);
  nb::class_<NormalEquations> equations(m, "NormalEquations");
  equations
      .def(nb::new_(&make_equations), "topology"_a, "elimination"_a, "measurements"_a,
           "information"_a, "threads"_a = 1, "offsets"_a = nb::none(),
           "range_bearing"_a = nb::none())
      .def(
          "chi2",
          [](NormalEquations& e, const Table<double>& poses) {
            const double* const p = check_poses(e, poses);
            nb::gil_scoped_release release;
            return e.cost(p, EdgeLosses());
          },
          "poses"_a)
      .def(
          "linearize",
          [](NormalEquations& e, const Table<double>& poses,
             const std::optional<Vector<double>>& weights) {
            const double* const p = check_poses(e, poses);
            std::span<const double> w;
            if (weights) {
              w = span_of(*weights);
              require(w.size() == static_cast<std::size_t>(e.factors()), "one weight an edge");
            }
            nb::gil_scoped_release release;
            return e.linearize(p, EdgeLosses(w));
          },
          "poses"_a, "weights"_a = nb::none())
      .def(
          "robust_cost",
          [](NormalEquations& e, const Table<double>& poses, const Loss& loss,
             const std::optional<Vector<bool>>& trusted) {
            const double* const p = check_poses(e, poses);
            const EdgeLosses losses(loss, mask_of(e, trusted));
            nb::gil_scoped_release release;
            return e.cost(p, losses);
          },
          "poses"_a, "loss"_a, "trusted"_a = nb::none())
      .def(
          "linearize_robust",
          [](NormalEquations& e, const Table<double>& poses, const Loss& loss,
             const std::optional<Vector<bool>>& trusted) {
            const double* const p = check_poses(e, poses);
            const EdgeLosses losses(loss, mask_of(e, trusted));
            nb::gil_scoped_release release;
            return e.linearize(p, losses);
          },
          "poses"_a, "loss"_a, "trusted"_a = nb::none())
      .def("rhs",
           [](const NormalEquations& e) {
             return as_array(std::vector<double>(e.rhs().begin(), e.rhs().end()));
           })
      .def("diagonal",
           [](const NormalEquations& e) {
             std::vector<double> out(rows_of(e));
             e.diagonal(out.data());
             return as_array(std::move(out));
           })
      .def(
          "multiply",
          [](const NormalEquations& e, const Vector<double>& v) {
            require(v.shape(0) == rows_of(e), "the vector must have an entry an unknown");
            std::vector<double> out(rows_of(e));
            {
              nb::gil_scoped_release release;
              e.multiply(v.data(), out.data());
            }
            return as_array(std::move(out));
          },
          "v"_a)
      .def("pivot_ratio", &NormalEquations::pivot_ratio)
      .def("solve", &step_of)
      .def(
          "inverse",
          [](const NormalEquations& e, const Vector<std::int32_t>& rows,
             const Vector<std::int32_t>& columns) {
            return blocks_of_inverse(e, static_cast<std::int32_t>(e.free_nodes().size()), e.dof(),
                                     rows, columns);
          },
          "rows"_a, "columns"_a)
      .def("retract", &moved, "poses"_a, "step"_a);
  bind_part(equations);
}

}  // namespace masat
