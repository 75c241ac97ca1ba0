// What has been added to a map or removed from it since the last update.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <vector>

#include "graph/information.hpp"
#include "lie/group.hpp"

namespace masat {

template <LieGroup Group>
struct PendingEdge {
  std::int32_t from, to;
  std::int64_t number;
  Group measured;
  typename Group::Square information;
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
