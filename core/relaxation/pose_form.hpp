// The chordal cost of a pose graph as a quadratic form.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "graph/topology.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

// Sets the matrix to the form rotation |R_j - R_i R|^2 + translation |t_j - t_i - R_i t|^2 of the
// unknowns X_i = [R_i t_i]', and adds what held nodes make of the right-hand side.
template <class Group>
void assemble_pose_form(GraphMatrix& matrix, const Topology& graph, const double* measurements,
                        const double* rotation, const double* translation, const double* values,
                        int columns, double* forcing) {
  constexpr int kRows = Group::kDimension + 1;
  using Block = Eigen::Matrix<double, kRows, kRows, Eigen::RowMajor>;
  const auto m = static_cast<std::int64_t>(graph.edges().size());
  const typename Group::Table z(measurements, m);
  matrix.set_zero();
  for (std::int64_t k = 0; k < m; ++k) {
    Block turn = Block::Identity();  // X_j is to be turn' X_i
    turn.template topLeftCorner<kRows - 1, kRows - 1>() = z[k].rotation();
    turn.template topRightCorner<kRows - 1, 1>() = z[k].translation();
    Block weight = Block::Identity() * rotation[k];
    weight(kRows - 1, kRows - 1) = translation[k];
    const Block joint = -turn * weight, first = -joint * turn.transpose();
    matrix.add_edge(graph, k, first.data(), joint.data(), weight.data(), values, columns, forcing);
  }
}

}  // namespace masat
