// What has been added to a map or removed from it since the last update.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <vector>

#include "factors/sensor.hpp"
#include "graph/information.hpp"
#include "lie/group.hpp"
#include "online/online_map.hpp"

namespace masat {

// What an edge may do to the components of the nodes that it joins.
enum class Joining : std::uint8_t {
  kMoves,   // move one of them to where it says
  kPlaces,  // place a point that nothing measures; else they have to be one component
  kNever,   // they have to be one component
  kStays,   // join them where they are
};

template <LieGroup Group>
struct PendingEdge {
  std::int32_t from, to;
  std::int64_t number;
  Group measured;
  typename Group::Square information;
  Joining joining = Joining::kMoves;
  Sensor<Group> sensor = {};
};

template <LieGroup Group>
struct PendingChanges {
  std::vector<PendingEdge<Group>> edges;
  std::vector<std::int64_t> removals;  // numbers of edges
  bool empty() const { return edges.empty() && removals.empty(); }
  void clear() {
    edges.clear();
    removals.clear();
  }
};

template <LieGroup Group>
Sensor<Group> sensor_of(const SensorEdges& edges, std::size_t k) {
  const Group offset = Group::load(&edges.offsets[k * Group::kSize]);
  const bool has_offset = error(Group{}, Group{}, offset) != Group::Tangent::Zero();
  return {has_offset, edges.range_bearing[k] != 0, offset};
}

// Whether the numbers of a pose are finite, and its quaternion of unit length up to rounding.
template <LieGroup Group>
bool is_plain_pose(const double* pose) {
  constexpr double kUnitToRounding = 1e-14;  // as in the checks of a graph
  for (int i = 0; i < Group::kSize; ++i) {
    if (!std::isfinite(pose[i])) return false;
  }
  if constexpr (Group::kSize > Group::kDof) {
    double squared = 0;
    for (int i = Group::kDimension; i < Group::kSize; ++i) squared += pose[i] * pose[i];
    return std::abs(squared - 1) <= kUnitToRounding;
  }
  return true;
}

// Whether a matrix is finite, exactly symmetric and positive definite.
template <LieGroup Group>
bool is_plain_information(const double* matrix) {
  const Eigen::Map<const typename Group::Square> m(matrix);
  return m.allFinite() && m == m.transpose() &&
         not_positive_definite<Group::kDof>(matrix, 1).empty();
}

}  // namespace masat
