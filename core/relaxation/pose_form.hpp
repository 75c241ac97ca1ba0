// The chordal cost of a pose graph as a quadratic form of its nodes' unknowns.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "graph/topology.hpp"
#include "lie/group.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

// Rows of a node's unknown X, see lifted.hpp: in 3D [R t]', in 2D the complex numbers of the
// rotation and of the translation, each a row of real and a row of imaginary parts.
constexpr int kLiftedRows = 4;
using LiftedBlock = Eigen::Matrix<double, kLiftedRows, kLiftedRows, Eigen::RowMajor>;

// The matrix T of a relative pose z: a pose z ahead of the pose of X has the unknown T X. Its first
// columns are the X of z itself.
template <LieGroup Group>
LiftedBlock lifted_pose(const Group& z) {
  LiftedBlock out = LiftedBlock::Identity();
  if constexpr (Group::kDimension == 2) {
    out.topLeftCorner<2, 2>() = z.rotation();
    const auto t = z.translation();
    out.bottomLeftCorner<2, 2>() << t.x(), -t.y(), t.y(), t.x();
  } else {
    out.topLeftCorner<3, 3>() = z.rotation().transpose();
    out.bottomLeftCorner<1, 3>() = z.translation().transpose();
  }
  return out;
}

// What an edge's rotation costs: a number an edge, or in 3D a matrix A, which need not be
// symmetric, row by row.
struct RotationWeights {
  const double* values;
  bool matrices;

  // The W for which <X, W Y> of two rotations' X and Y is <A, R_X' R_Y>.
  template <int D>
  Eigen::Matrix<double, D, D> at(std::int64_t edge) const {
    using Square = Eigen::Matrix<double, D, D, Eigen::RowMajor>;
    if (matrices) return Eigen::Map<const Square>(values + edge * D * D);
    // |R|^2 is 2 in 2D, where the complex number of a rotation has the length 1.
    return Square::Identity() * (D == 2 ? 2 * values[edge] : values[edge]);
  }
};

// Sets the matrix to the form
//     2 tr(A) - 2 <A, R' R_i' R_j> + translation |t_j - t_i - R_i t|^2
// of the unknowns X_i, and adds the right-hand side from the fixed nodes to `linear_term`. For
// A = kappa I the first two terms are kappa |R_j - R_i R|^2. For 2 tr(A) the form has a multiple of
// the squared lengths of both frames, which are the same for all rotations. With `offsets`, one an
// edge, an edge measures a sensor in the place of the node that it leads to.
template <LieGroup Group>
void assemble_pose_form(GraphMatrix& matrix, const Topology& graph, const double* measurements,
                        RotationWeights rotation, const double* translation, const double* offsets,
                        const double* values, int columns, double* linear_term) {
  constexpr int D = Group::kDimension;
  const auto m = static_cast<std::int64_t>(graph.edges().size());
  const typename Group::Table z(measurements, m);
  matrix.set_zero();
  for (std::int64_t k = 0; k < m; ++k) {
    const LiftedBlock turn = lifted_pose<Group>(z[k]);
    LiftedBlock weight = LiftedBlock::Identity() * translation[k], own = weight;
    weight.topLeftCorner<D, D>() = rotation.at<D>(k);
    own.topLeftCorner<D, D>().diagonal().setConstant(weight.topLeftCorner<D, D>().trace() / D);
    const LiftedBlock first = turn.transpose() * own * turn;
    LiftedBlock joint = -turn.transpose() * weight;
    if (offsets != nullptr) {
      const LiftedBlock at_sensor = lifted_pose(Group::load(offsets + k * Group::kSize));
      joint = (joint * at_sensor).eval();
      own = (at_sensor.transpose() * own * at_sensor).eval();
    }
    matrix.add_edge(graph, k, first.data(), joint.data(), own.data(), values, columns, linear_term);
  }
}

}  // namespace masat
