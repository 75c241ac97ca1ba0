// The chordal cost of a pose graph as a quadratic form.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "graph/topology.hpp"
#include "lie/group.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

// What an edge's rotation costs: a number an edge, or a d x d matrix A, which need not be
// symmetric, row by row.
struct RotationWeights {
  const double* values;
  bool matrices;

  template <int D>
  Eigen::Matrix<double, D, D, Eigen::RowMajor> at(std::int64_t edge) const {
    using Square = Eigen::Matrix<double, D, D, Eigen::RowMajor>;
    if (matrices) return Eigen::Map<const Square>(values + edge * D * D);
    return Square::Identity() * values[edge];
  }
};

// Sets the matrix to the form
//     2 tr(A) - 2 <A, R' R_i' R_j> + translation |t_j - t_i - R_i t|^2
// of the unknowns X_i = [R_i t_i]', and adds the right-hand side from the fixed nodes to
// `linear_term`. For A = kappa I the first two terms are kappa |R_j - R_i R|^2. The form has
// (tr(A) / d) (|R_i|^2 + |R_j|^2) for 2 tr(A), which is the same for orthonormal frames. With
// `offsets`, one an edge, an edge measures a sensor in the place of the node that it leads to.
template <LieGroup Group>
void assemble_pose_form(GraphMatrix& matrix, const Topology& graph, const double* measurements,
                        RotationWeights rotation, const double* translation, const double* offsets,
                        const double* values, int columns, double* linear_term) {
  constexpr int D = Group::kDimension, kRows = D + 1;
  using Block = Eigen::Matrix<double, kRows, kRows, Eigen::RowMajor>;
  const auto m = static_cast<std::int64_t>(graph.edges().size());
  const typename Group::Table z(measurements, m);
  matrix.set_zero();
  for (std::int64_t k = 0; k < m; ++k) {
    Block turn = Block::Identity();  // with zero cost, X_j = turn' X_i
    turn.template topLeftCorner<D, D>() = z[k].rotation();
    turn.template topRightCorner<D, 1>() = z[k].translation();
    Block weight = Block::Identity() * translation[k], own = weight;
    weight.template topLeftCorner<D, D>() = rotation.at<D>(k);
    own.template topLeftCorner<D, D>().diagonal().setConstant(
        weight.template topLeftCorner<D, D>().trace() / D);
    const Block first = turn * own * turn.transpose();
    Block joint = -turn * weight;
    if (offsets != nullptr) {
      const Group offset = Group::load(offsets + k * Group::kSize);
      Block at_sensor = Block::Identity();  // X of the sensor is at_sensor X_j
      at_sensor.template topLeftCorner<D, D>() = offset.rotation().transpose();
      at_sensor.template bottomLeftCorner<1, D>() = offset.translation().transpose();
      joint = (joint * at_sensor).eval();
      own = (at_sensor.transpose() * own * at_sensor).eval();
    }
    matrix.add_edge(graph, k, first.data(), joint.data(), own.data(), values, columns, linear_term);
  }
}

}  // namespace masat
