// Residuals of the edges, and their share of chi2, at some poses.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "graph/topology.hpp"

namespace masat {

// Calls f(k, e) with the residual of each edge.
template <class Group, class F>
void for_each_residual(const Topology& graph, const double* measurements, const double* poses,
                       F f) {
  const auto m = static_cast<std::int64_t>(graph.edges().size());
  const typename Group::Table z(measurements, m), pose(poses, graph.nodes());
  for (std::int64_t k = 0; k < m; ++k) {
    const Edge& edge = graph.edges()[k];
    f(k, error(z[k], pose[edge.from], pose[edge.to]));
  }
}

template <class Group>
void residuals(const Topology& graph, const double* measurements, const double* poses,
               double* out) {
  for_each_residual<Group>(graph, measurements, poses,
                           [&](std::int64_t k, const typename Group::Tangent& e) {
                             Eigen::Map<typename Group::Tangent>(out + k * Group::kDof) = e;
                           });
}

// e' W e of each edge.
template <class Group>
void chi2_per_edge(const Topology& graph, const double* measurements, const double* information,
                   const double* poses, double* out) {
  using Square = typename Group::Square;
  constexpr int kBlock = Group::kDof * Group::kDof;
  for_each_residual<Group>(graph, measurements, poses,
                           [&](std::int64_t k, const typename Group::Tangent& e) {
                             out[k] = e.dot(Eigen::Map<const Square>(information + k * kBlock) * e);
                           });
}

}  // namespace masat
