// The translations that minimize chi2 at given rotations.
#pragma once

#include <cstdint>
#include <vector>

#include "graph/topology.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

// Moves the poses of the free nodes. Errors are linear in the translations: one Gauss-Newton step
// in them is exact. Leaves its system in the matrix, whose blocks have a row a coordinate. Returns
// -1, or the node whose translation is not determined.
template <class Group>
std::int32_t solve_translations(const Topology& graph, GraphMatrix& matrix,
                                 const double* measurements, const double* information,
                                 double* poses) {
  constexpr int kDimension = Group::kDimension, kDof = Group::kDof;
  using Square = typename Group::Square;
  using Block = Eigen::Matrix<double, kDimension, kDimension>;
  using Vector = Eigen::Matrix<double, kDimension, 1>;
  const auto m = static_cast<std::int64_t>(graph.edges().size());
  const typename Group::Table z(measurements, m), pose(poses, graph.nodes());
  const Elimination* const elimination = matrix.elimination().get();
  matrix.set_zero();
  std::vector<double> step(matrix.rows());
  const auto segment = [&](std::int32_t place) {
    return Eigen::Map<Vector>(&step[std::int64_t{kDimension} * place]);
  };
  for (std::int64_t k = 0; k < m; ++k) {
    const Edge& edge = graph.edges()[k];
    const std::int32_t a = elimination->place(edge.from), b = elimination->place(edge.to);
    Square from, to;
    const typename Group::Tangent e = error(z[k], pose[edge.from], pose[edge.to], from, to);
    const Eigen::Map<const Square> weight(information + k * kDof * kDof);
    const Vector we = weight.template topRows<kDimension>() * e;
    const Block w = weight.template topLeftCorner<kDimension, kDimension>();
    const Block ja = from.template topLeftCorner<kDimension, kDimension>();
    const Block jb = to.template topLeftCorner<kDimension, kDimension>();
    const auto add = [](double* block, const Block& h) { Eigen::Map<Block>{block} += h; };
    if (a >= 0) {
      add(matrix.node_block(a), ja.transpose() * w * ja);
      segment(a).noalias() -= ja.transpose() * we;
    }
    if (b >= 0) {
      add(matrix.node_block(b), jb.transpose() * w * jb);
      segment(b).noalias() -= jb.transpose() * we;
    }
    if (a >= 0 && b >= 0) {
      const Block& lesser = a < b ? ja : jb;
      const Block& greater = a < b ? jb : ja;
      add(matrix.joint_block(k), greater.transpose() * w * lesser);
    }
  }
  const std::vector<double> undamped(step.size());
  const std::int32_t broken = matrix.factorize(undamped);
  if (broken >= 0) return elimination->free_nodes()[broken];
  matrix.solve(step);
  for (const std::int32_t node : elimination->free_nodes()) {
    double tangent[kDof] = {};
    const Vector moved = segment(elimination->place(node));
    for (int i = 0; i < kDimension; ++i) tangent[i] = moved[i];
    (pose[node] * Group::from_tangent(tangent)).store(poses + std::int64_t{Group::kSize} * node);
  }
  return -1;
}

}  // namespace masat
