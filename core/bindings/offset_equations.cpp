// The normal equations of edges that measure sensors on the nodes.
#include <nanobind/nanobind.h>

#include <cstddef>
#include <memory>
#include <utility>

#include "bindings/arrays.hpp"
#include "bindings/bindings.hpp"
#include "factors/offset_pose.hpp"
#include "graph/topology.hpp"
#include "optimizers/normal_equations.hpp"

namespace masat {
namespace {

// Keeps alive what the equations refer to.
template <class Group>
class OffsetEquations final : public NormalEquationsOf<Group, OffsetPoseFactors<Group>> {
 public:
  OffsetEquations(nb::object topology, std::shared_ptr<Elimination> elimination,
                  const Table<double>& measurements, const Stack& information,
                  const Table<double>& offsets, int threads)
      : NormalEquationsOf<Group, OffsetPoseFactors<Group>>(
            OffsetPoseFactors<Group>(nb::inst_ptr<Topology>(topology)->edges(), measurements.data(),
                                     information.data(), offsets.data()),
            std::move(elimination), threads),
        topology_(std::move(topology)),
        measurements_(measurements),
        information_(information),
        offsets_(offsets) {}

 private:
  nb::object topology_;
  Table<double> measurements_;
  Stack information_;
  Table<double> offsets_;
};

}  // namespace

std::unique_ptr<NormalEquations> equations_at_offsets(nb::object topology,
                                                      std::shared_ptr<Elimination> elimination,
                                                      const Table<double>& measurements,
                                                      const Stack& information,
                                                      const Table<double>& offsets, int threads) {
  const std::size_t size = measurements.shape(1);
  require(offsets.shape(0) == measurements.shape(0) && offsets.shape(1) == size,
          "one offset an edge");
  nb::gil_scoped_release release;
  return with_group(size, [&]<class Group>(Group*) -> std::unique_ptr<NormalEquations> {
    require(information.shape(1) == Group::kDof && information.shape(2) == Group::kDof,
            "information must be (m, d, d)");
    return std::make_unique<OffsetEquations<Group>>(std::move(topology), std::move(elimination),
                                                    measurements, information, offsets, threads);
  });
}

}  // namespace masat
