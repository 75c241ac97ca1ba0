// Blocks of the inverse of a growing factor's H.
// Kaess, Dellaert, "Covariance recovery from a square root information matrix for data
// association", Robotics and Autonomous Systems 2009.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <span>
#include <unordered_map>
#include <utility>
#include <vector>

#include "online/growing_factor.hpp"

namespace masat {

// The block of two nodes is Y_a' Y_b with Y = L^-1 times a node's columns of the identity, which is
// zero except along the path from the node's front to the root.
template <LieGroup Group>
class JointCovariance {
 public:
  static constexpr int kDof = Group::kDof;
  using Factor = GrowingFactor<Group>;
  using Square = typename Group::Square;
  using Columns = Eigen::Matrix<double, Eigen::Dynamic, kDof>;

  // Writes a block for each pair, row-major; those of fixed nodes are zero.
  void write(const Factor& factor, std::span<const std::int32_t> rows,
             std::span<const std::int32_t> columns, double* out) {
    carried_.resize(factor.nodes(), Square::Zero());
    std::unordered_map<std::int32_t, Path> paths;
    for (const auto& nodes : {rows, columns}) {
      for (const std::int32_t node : nodes) {
        if (!paths.contains(node)) paths.emplace(node, solve(factor, node));
      }
    }
    for (std::size_t k = 0; k < rows.size(); ++k, out += kDof * kDof) {
      // Row-major, so that the transpose is what Eigen stores.
      Eigen::Map<Square>{out} = product(paths.at(columns[k]), paths.at(rows[k]));
    }
  }

 private:
  struct Path {
    std::vector<std::int32_t> fronts;  // up to the root
    std::vector<Columns> solved;       // the columns of Y at the pivots of each
  };

  Path solve(const Factor& factor, std::int32_t node) {
    Path path;
    std::int32_t f = factor.front_of(node);
    if (f >= 0) carried_[node].setIdentity();
    for (; f >= 0; f = factor.front(f).parent) {
      const auto& front = factor.front(f);
      const Front& dense = front.dense;
      x_.resize(dense.ld11 + dense.ld21 + 2 * kLine);
      double* const x = aligned(x_.data());
      double* const y = x + (dense.ld11 + kLine - 1) / kLine * kLine;
      Columns solved(dense.pivots, kDof);
      for (int c = 0; c < kDof; ++c) {
        std::fill(x, x + dense.ld11, 0.0);
        for (std::int32_t k = 0; k < front.pivots; ++k) {
          Eigen::Map<typename Group::Tangent>{x + std::int64_t{k}* kDof} =
              carried_[front.nodes[k]].col(c);
        }
        kernels_->forward(dense, front.reciprocal, x, y);
        solved.col(c) = Eigen::Map<const Eigen::VectorXd>(x, dense.pivots);
        const double* from = y;
        for (const std::int32_t row : front.rows()) {
          carried_[row].col(c) -= Eigen::Map<const typename Group::Tangent>(from);
          from += kDof;
        }
      }
      for (std::int32_t k = 0; k < front.pivots; ++k) carried_[front.nodes[k]].setZero();
      path.fronts.push_back(f);
      path.solved.push_back(std::move(solved));
    }
    return path;
  }

  // Two paths are the same from where they meet.
  static Square product(const Path& a, const Path& b) {
    Square sum = Square::Zero();
    auto i = a.fronts.size(), j = b.fronts.size();
    while (i > 0 && j > 0 && a.fronts[i - 1] == b.fronts[j - 1]) {
      sum.noalias() += a.solved[--i].transpose() * b.solved[--j];
    }
    return sum;
  }

  static constexpr std::int64_t kLine = 8;
  static double* aligned(double* p) {
    return p + (kLine - reinterpret_cast<std::uintptr_t>(p) / sizeof(double) % kLine) % kLine;
  }

  std::vector<Square> carried_;  // of each node: what its columns get from below; zero in between
  std::vector<double> x_;
  const Kernels* kernels_ = &kernels();
};

}  // namespace masat
