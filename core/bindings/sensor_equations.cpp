// The normal equations of edges that measure sensors on the nodes, or range and bearing.
#include <nanobind/nanobind.h>

#include <cstddef>
#include <memory>
#include <optional>
#include <utility>

#include "bindings/arrays.hpp"
#include "bindings/bindings.hpp"
#include "factors/sensor.hpp"
#include "graph/topology.hpp"
#include "optimizers/normal_equations.hpp"

namespace masat {
namespace {

// Keeps alive what the equations refer to.
template <class Group>
class SensorEquations final : public NormalEquationsOf<Group, SensorFactors<Group>> {
 public:
  SensorEquations(nb::object topology, std::shared_ptr<Elimination> elimination,
                  const Table<double>& measurements, const Stack& information,
                  const std::optional<Table<double>>& offsets,
                  const std::optional<Vector<bool>>& range_bearing, int threads)
      : NormalEquationsOf<Group, SensorFactors<Group>>(
            SensorFactors<Group>(nb::inst_ptr<Topology>(topology)->edges(), measurements.data(),
                                 information.data(),
                                 data_of(offsets, measurements.shape(0), measurements.shape(1)),
                                 flags_of(range_bearing, measurements.shape(0))),
            std::move(elimination), threads),
        topology_(std::move(topology)),
        measurements_(measurements),
        information_(information),
        offsets_(offsets),
        range_bearing_(range_bearing) {}

 private:
  nb::object topology_;
  Table<double> measurements_;
  Stack information_;
  std::optional<Table<double>> offsets_;
  std::optional<Vector<bool>> range_bearing_;
};

}  // namespace

std::unique_ptr<NormalEquations> sensor_equations(nb::object topology,
                                                  std::shared_ptr<Elimination> elimination,
                                                  const Table<double>& measurements,
                                                  const Stack& information,
                                                  const std::optional<Table<double>>& offsets,
                                                  const std::optional<Vector<bool>>& range_bearing,
                                                  int threads) {
  nb::gil_scoped_release release;
  return with_group(
      measurements.shape(1), [&]<class Group>(Group*) -> std::unique_ptr<NormalEquations> {
        require(information.shape(1) == Group::kDof && information.shape(2) == Group::kDof,
                "information must be (m, d, d)");
        return std::make_unique<SensorEquations<Group>>(std::move(topology), std::move(elimination),
                                                        measurements, information, offsets,
                                                        range_bearing, threads);
      });
}

}  // namespace masat
