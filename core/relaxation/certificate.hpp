// The certificate of the lifted chordal problem: how far below a point's cost others may lie.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "relaxation/lifted.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

// At a point x, with the multipliers Lambda there: S = M - Lambda, and g = S x - F.
template <int D, int P>
class Certificate {
 public:
  using Problem = Lifted<D, P>;

  Certificate(const Problem& problem, const std::vector<double>& x)
      : nodes_(problem.nodes()), s_(problem.matrix()) {
    problem.evaluate(x, gradient_);
    for (std::int32_t k = 0; k < nodes_; ++k) {
      const typename Problem::Square multiplier = Problem::multiplier(x, gradient_, k);
      Eigen::Map<typename Problem::Frame>{&gradient_[std::int64_t{k} * Problem::kSize]} -=
          multiplier * Problem::frame(x, k);
      Eigen::Map<Block>(s_.node_block(k)).template topLeftCorner<D, D>() -= multiplier;
    }
  }

  // How far the cost of any y may lie below that of x: infinite unless B = S + shift on the frames'
  // rows - margin |diag(S)| is positive definite. The margin covers the rounding of its
  // factorization. With y = x + d,
  //     cost(y) - cost(x) = 2 <g, d> + <d, S d> >= 2 <g, d> + <d, B d> - shift |its frames|^2,
  // which is least at B d = -g; frames differ by at most 2 in each of their unit vectors.
  double gap(double shift, double margin) {
    std::vector<double> added = on_frames(shift), diagonal(s_.rows());
    s_.diagonal(diagonal.data());
    for (std::size_t i = 0; i < added.size(); ++i) added[i] -= margin * std::abs(diagonal[i]);
    if (s_.factorize(added) >= 0) return std::numeric_limits<double>::infinity();
    std::vector<double> solved = gradient_;
    s_.solve(solved, P);
    double below = 4.0 * Problem::Frames::kUnits * shift * nodes_;
    for (std::size_t i = 0; i < solved.size(); ++i) below += gradient_[i] * solved[i];
    return std::isfinite(below) ? below : std::numeric_limits<double>::infinity();
  }

  // Free nodes, ascending, whose fixing makes S + shift on the frames' rows positive definite.
  std::vector<std::int32_t> uncertified(double shift) {
    std::vector<double> fixing(s_.rows());
    for (std::int32_t k = 0; k < nodes_; ++k) {
      const double trace = std::abs(Eigen::Map<const Block>(s_.node_block(k)).trace());
      std::fill_n(&fixing[std::int64_t{k} * Problem::kRows], Problem::kRows,
                  std::fmax(kFixing * trace, std::numeric_limits<double>::min()));
    }
    return s_.indefinite(on_frames(shift), fixing);
  }

 private:
  // What fixes a node is added to its diagonal: this much more than what is there.
  static constexpr double kFixing = 1e6;
  using Block = Eigen::Matrix<double, Problem::kRows, Problem::kRows>;

  std::vector<double> on_frames(double shift) const {
    std::vector<double> out(s_.rows());
    for (std::int32_t k = 0; k < nodes_; ++k) {
      std::fill_n(&out[std::int64_t{k} * Problem::kRows], D, shift);
    }
    return out;
  }

  std::int32_t nodes_;
  GraphMatrix s_;
  std::vector<double> gradient_;
};

}  // namespace masat
