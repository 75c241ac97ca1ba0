// Newton's method for the lifted chordal problem.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "interrupt.hpp"
#include "relaxation/lifted.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

struct LiftedLimits {
  double decrease;  // the last step is one that promises less than this fraction of the cost
  double damping;   // of the frames, to begin with
  int steps;
};

// Each step solves for frames and translations together by one factorization, damped as by
// Levenberg and Marquardt; the translations are then solved exactly for the new frames.
template <int D, int P>
class LiftedMinimizer {
 public:
  using Problem = Lifted<D, P>;

  explicit LiftedMinimizer(const Problem& problem)
      : problem_(problem),
        nodes_(problem.nodes()),
        laplacian_(problem.matrix().elimination(), 1),
        hessian_(problem.matrix().elimination(), kDof),
        basis_(nodes_),
        gradient_(std::int64_t{nodes_} * kDof),
        magnitude_(nodes_) {}

  // Minimizes from the orthonormalized x. Returns -1, or a free node's index: there the matrix of
  // the translations is not positive definite, or a number is not finite, and x is unchanged.
  std::int32_t minimize(std::vector<double>& x, const LiftedLimits& limits) {
    set_laplacian();
    const std::int32_t failed = laplacian_.factorize(std::vector<double>(nodes_));
    if (failed >= 0) return failed;
    std::vector<double> current = x, moved(x.size()), moved_residual;
    for (std::int32_t k = 0; k < nodes_; ++k) {
      Eigen::Map<Frame> own(&current[std::int64_t{k} * kSize]);
      own = Frames::orthonormal(own);
    }
    double cost = solve_translations(current, residual_);
    if (nodes_ > 0 && !std::isfinite(cost)) return problem_.node_not_finite(x);

    std::vector<double> step(gradient_.size()), damping(gradient_.size());
    double strength = limits.damping;
    double insufficient = 0;  // the greatest recent strength that was not enough
    bool accepted = true;
    for (int tried = 0; tried < limits.steps; ++tried) {
      check_interrupt();
      if (accepted) linearize(current);
      accepted = false;
      for (std::int32_t k = 0; k < nodes_; ++k) {
        std::fill_n(&damping[std::int64_t{k} * kDof], Frames::kDof, strength);
      }
      if (hessian_.factorize(damping) >= 0) {
        insufficient = strength;
        strength *= kGrowth;
        continue;
      }
      step = gradient_;
      hessian_.solve(step);
      double predicted = 0, damped = 0;
      for (std::size_t i = 0; i < step.size(); ++i) {
        predicted += step[i] * gradient_[i];
        damped += damping[i] * step[i] * step[i];
      }
      predicted += damped;
      if (predicted <= rounding(step)) break;

      retract(current, step, moved);
      const double moved_cost = solve_translations(moved, moved_residual);
      const double decrease = decrease_to(current, moved, moved_residual);
      // Written so that a result that is not a number is refused.
      if (std::isfinite(moved_cost) && decrease > kAccepted * predicted) {
        accepted = true;
        current.swap(moved);
        residual_.swap(moved_residual);
        cost = moved_cost;
        // That a step is short proves little where the damping made it so.
        const bool free = damped < kUndamped * predicted;
        if (predicted <= (free ? 1.0 : kDamped) * limits.decrease * cost) break;
        if (decrease > kGood * predicted) {
          strength = std::max(strength / kDecay, std::sqrt(strength * insufficient));
        }
        insufficient *= kForgotten;
      } else {
        insufficient = strength;
        strength *= kGrowth;
      }
    }
    x.swap(current);
    return -1;
  }

 private:
  // Factors of the damping after a refused and a good step, and of what is remembered of the
  // former; fractions of the predicted decrease at which a step is accepted, and good; the fraction
  // due to the damping below which a step counts as free, and how much less than a free one
  // another last step must promise.
  static constexpr double kGrowth = 3, kDecay = 10, kForgotten = 0.5, kAccepted = 0.05, kGood = 0.5,
                          kUndamped = 0.3, kDamped = 1e-3;
  // In units of the spacing of numbers at the sum of the magnitudes that cancel: a row of M x adds
  // some ten products, and x itself is rounded.
  static constexpr double kRounding = 4 * std::numeric_limits<double>::epsilon();

  using Frames = typename Problem::Frames;
  using Frame = typename Problem::Frame;
  static constexpr int kRows = Problem::kRows, kSize = Problem::kSize, kShifts = Problem::kShifts,
                       kDof = Problem::kDof;
  using Square = Eigen::Matrix<double, kRows, kRows>;
  using Column = Eigen::Matrix<double, kRows, 1>;
  using Turns = Eigen::Matrix<double, P, Frames::kDof>;

  // The translations have the same matrix in each of their numbers.
  void set_laplacian() {
    const auto entries = static_cast<std::int64_t>(problem_.matrix().pattern().row.size());
    for (std::int64_t e = 0; e < entries; ++e) {
      *laplacian_.block(e) = problem_.matrix().block(e)[kRows * kRows - 1];
    }
  }

  // Moves the translations to their minimum for the frames; sets the residual and returns the cost.
  double solve_translations(std::vector<double>& x, std::vector<double>& residual) const {
    problem_.evaluate(x, residual);
    std::vector<double> steps(std::int64_t{nodes_} * kShifts);
    for (std::int32_t k = 0; k < nodes_; ++k) {
      std::copy_n(&residual[std::int64_t{k} * kSize + D * P], kShifts,
                  &steps[std::int64_t{k} * kShifts]);
    }
    laplacian_.solve(steps, kShifts);
    for (std::int32_t k = 0; k < nodes_; ++k) {
      for (int i = 0; i < kShifts; ++i) {
        x[std::int64_t{k} * kSize + D * P + i] -= steps[std::int64_t{k} * kShifts + i];
      }
    }
    return problem_.evaluate(x, residual);
  }

  // How much lower than at x the cost is at `to`: by their difference, since the costs themselves
  // are sums of large terms that cancel.
  double decrease_to(const std::vector<double>& x, const std::vector<double>& to,
                     const std::vector<double>& residual) const {
    double out = 0;
    for (std::size_t i = 0; i < x.size(); ++i) out += (x[i] - to[i]) * (residual_[i] + residual[i]);
    return out;
  }

  // What the rounding of M x alone may make of the predicted decrease of a step.
  double rounding(const std::vector<double>& step) const {
    double sum = 0;
    for (std::int32_t k = 0; k < nodes_; ++k) {
      const double* const own = &step[std::int64_t{k} * kDof];
      const Eigen::Map<const Eigen::Matrix<double, Frames::kDof, 1>> turn(own);
      const Eigen::Map<const Eigen::Matrix<double, kShifts, 1>> shift(own + Frames::kDof);
      sum += turn.norm() * magnitude_[k].template head<D>().norm() +
             shift.norm() * magnitude_[k].template tail<kRows - D>().norm();
    }
    return kRounding * sum;
  }

  // The coordinates of what a vector a does to the frame: sum over its rows.
  static Turns combine(const typename Frames::Basis& basis, const Eigen::Matrix<double, D, 1>& a) {
    Turns out = a[0] * basis.template topRows<P>();
    for (int i = 1; i < D; ++i) out += a[i] * basis.template middleRows<P>(i * P);
    return out;
  }

  // The lengths of the rows of a node's unknown.
  static Column lengths(const std::vector<double>& x, std::int32_t k) {
    return Eigen::Map<const RowByRow<kRows, P>>(&x[std::int64_t{k} * kSize]).rowwise().norm();
  }

  // Sets the gradient's negative half and half the Hessian in the coordinates of the tangent
  // spaces, and the magnitudes |M| |x| + |F| whose sums the residual is.
  void linearize(const std::vector<double>& x) {
    for (std::int32_t k = 0; k < nodes_; ++k) {
      basis_[k] = Frames::basis(Problem::frame(x, k));
      const double* const residual = &residual_[std::int64_t{k} * kSize];
      double* const out = &gradient_[std::int64_t{k} * kDof];
      Eigen::Map<Eigen::Matrix<double, Frames::kDof, 1>>{out}.noalias() =
          -basis_[k].transpose() * Eigen::Map<const Eigen::Matrix<double, D * P, 1>>(residual);
      for (int i = 0; i < kShifts; ++i) out[Frames::kDof + i] = -residual[D * P + i];
      const double* const f = problem_.linear_term() + std::int64_t{k} * kSize;
      magnitude_[k] = Eigen::Map<const RowByRow<kRows, P>>(f).rowwise().norm();
    }
    const BlockPattern& pattern = problem_.matrix().pattern();
    for (std::int32_t c = 0; c < nodes_; ++c) {
      for (std::int64_t e = pattern.start[c]; e < pattern.start[c + 1]; ++e) {
        const std::int32_t r = pattern.row[e];
        Square m = Eigen::Map<const Square>(problem_.matrix().block(e));
        magnitude_[r] += m.cwiseAbs() * lengths(x, c);
        if (r == c) {
          m.template topLeftCorner<D, D>() -= Problem::multiplier(x, residual_, c);
        } else {
          magnitude_[c] += m.cwiseAbs().transpose() * lengths(x, r);
        }
        typename Frames::Basis turned = Frames::Basis::Zero();
        for (int i = 0; i < D; ++i) {
          for (int j = 0; j < D; ++j) {
            turned.template middleRows<P>(i * P) +=
                m(i, j) * basis_[c].template middleRows<P>(j * P);
          }
        }
        Eigen::Map<Eigen::Matrix<double, kDof, kDof>> h(hessian_.block(e));
        h.template topLeftCorner<Frames::kDof, Frames::kDof>().noalias() =
            basis_[r].transpose() * turned;
        for (int i = D, at = Frames::kDof; i < kRows; ++i, at += P) {
          h.template block<Frames::kDof, P>(0, at) =
              combine(basis_[r], m.template block<D, 1>(0, i)).transpose();
          h.template block<P, Frames::kDof>(at, 0) =
              combine(basis_[c], m.template block<1, D>(i, 0).transpose());
        }
        h.template bottomRightCorner<kShifts, kShifts>() =
            m(D, D) * Eigen::Matrix<double, kShifts, kShifts>::Identity();
      }
    }
  }

  void retract(const std::vector<double>& x, const std::vector<double>& step,
               std::vector<double>& out) const {
    for (std::int32_t k = 0; k < nodes_; ++k) {
      const double* const d = &step[std::int64_t{k} * kDof];
      const Eigen::Matrix<double, D * P, 1> turn =
          basis_[k] * Eigen::Map<const Eigen::Matrix<double, Frames::kDof, 1>>(d);
      double* const to = &out[std::int64_t{k} * kSize];
      Eigen::Map<Frame>{to} =
          Frames::orthonormal(Problem::frame(x, k) + Eigen::Map<const Frame>(turn.data()));
      for (int i = 0; i < kShifts; ++i) {
        to[D * P + i] = x[std::int64_t{k} * kSize + D * P + i] + d[Frames::kDof + i];
      }
    }
  }

  const Problem& problem_;
  std::int32_t nodes_;
  GraphMatrix laplacian_, hessian_;
  std::vector<typename Frames::Basis> basis_;
  std::vector<double> residual_, gradient_;
  std::vector<Column> magnitude_;
};

}  // namespace masat
