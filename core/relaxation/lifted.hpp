// The lifted chordal problem of a pose graph: rotations as orthonormal frames of any rank.
//
// A free node's unknown is X = [Y t]', D + 1 rows of P numbers: D orthonormal ones, the frame, and
// the translation. With P = D this is the chordal problem itself; local minima vanish as P grows.
// The cost is <X, M X> - 2 <X, F> + constant: M over the free nodes, F what the held ones make of
// the right-hand side. Source: Rosen, Carlone, Bandeira, Leonard, SE-Sync, IJRR 2019; here the
// translations stay unknowns, solved for anew after each step, which is Newton's, by a
// factorization.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "relaxation/stiefel.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

struct LiftedLimits {
  double decrease;  // stops where a step promises less than this share of the cost
  double damping;   // of the frames, to begin with
  int steps;
};

template <int D, int P>
class Lifted {
 public:
  using Frames = Stiefel<D, P>;
  using Frame = typename Frames::Frame;
  static constexpr int kRows = D + 1, kStep = kRows * P, kDof = Frames::kDof + P;

  // Matrix and forcing must outlive it.
  Lifted(const GraphMatrix& matrix, const double* forcing, double constant)
      : matrix_(matrix),
        forcing_(forcing),
        constant_(constant),
        nodes_(matrix.pattern().columns()),
        lambda_(nodes_),
        residual_(nodes_ * kStep) {}

  // Newton's method, damped as by Levenberg and Marquardt, from the orthonormalized x on. Returns
  // the steps tried.
  int minimize(std::vector<double>& x, const LiftedLimits& limits) {
    GraphMatrix hessian(matrix_.elimination(), kDof);
    std::vector<typename Frames::Basis> basis(nodes_);
    std::vector<double> gradient(nodes_ * kDof), step(gradient.size()), damping(gradient.size());
    std::vector<double> moved(x.size()), moved_residual(x.size());
    for (std::int32_t k = 0; k < nodes_; ++k) {
      Eigen::Map<Frame> own(&x[std::int64_t{k} * kStep]);
      own = Frames::orthonormal(own);
    }
    const GraphMatrix translations = laplacian();
    double lowest = settle(translations, x, residual_);
    // What the rounding of M x alone may make of the cost.
    const double rounding = 1e-15 * std::abs(constant_);
    double strength = limits.damping;
    double weak = 0;  // the greatest strength of late that was not enough
    bool moved_on = true;
    int steps = 0;
    while (steps < limits.steps) {
      ++steps;
      if (moved_on) linearize(x, basis, gradient, hessian);
      moved_on = false;
      for (std::int32_t k = 0; k < nodes_; ++k) {
        std::fill_n(&damping[std::int64_t{k} * kDof], Frames::kDof, strength);
      }
      if (hessian.factorize(damping) >= 0) {
        weak = strength;
        strength *= kGrowth;
        continue;
      }
      step = gradient;
      hessian.solve(step);
      double predicted = 0, damped = 0;
      for (std::size_t i = 0; i < step.size(); ++i) {
        predicted += step[i] * gradient[i];
        damped += damping[i] * step[i] * step[i];
      }
      predicted += damped;
      retract(x, basis, step, moved);
      const double cost = settle(translations, moved, moved_residual);
      // What is no number must not pass.
      const bool finite = std::isfinite(cost) && std::isfinite(predicted);
      const double gain = !finite ? -1.0 : predicted > rounding ? (lowest - cost) / predicted : 1.0;
      if (gain > kAccepted) {
        x.swap(moved);
        residual_.swap(moved_residual);
        lowest = cost;
        moved_on = true;
        // A step that damping made short proves nothing, unless it was to gain nothing at all.
        const double enough = limits.decrease * cost + rounding;
        if (predicted <= (damped < kUndamped * predicted ? enough : kNothing * enough)) break;
        if (gain > kGood) strength = std::max(strength / kDecay, std::sqrt(strength * weak));
        weak *= kForgotten;
      } else {
        weak = strength;
        strength *= kGrowth;
      }
    }
    return steps;
  }

  // How far any feasible point may lie below the cost of x: infinite unless S = M - Lambda + shift,
  // Lambda the multipliers at x and the shift on the frames, is positive definite. For y at x + d,
  //     cost(y) - cost(x) = 2 <g, d> + <d, S d> - shift |its frames|^2, g = (M - Lambda) x - F,
  // which is least at S d = -g; frames differ by at most 2 in each of their D rows.
  double gap(const std::vector<double>& x, double shift) {
    GraphMatrix s = certificate(x);
    std::vector<double> gradient = residual_;
    double below = 4.0 * D * shift * nodes_;
    for (std::int32_t k = 0; k < nodes_; ++k) {
      Eigen::Map<Frame>{&gradient[std::int64_t{k} * kStep]} -= lambda_[k] * frame(x, k);
    }
    if (s.factorize(on_frames(shift)) >= 0) return std::numeric_limits<double>::infinity();
    std::vector<double> solved = gradient;
    s.solve(solved, P);
    for (std::size_t i = 0; i < solved.size(); ++i) below += gradient[i] * solved[i];
    return below;
  }

  // Where S of above fails to be positive definite: nodes that, held still, let it be so.
  std::vector<std::int32_t> weak(const std::vector<double>& x, double shift) {
    GraphMatrix s = certificate(x);
    std::vector<double> held(s.rows());
    for (std::int32_t k = 0; k < nodes_; ++k) {
      const double trace = Eigen::Map<Eigen::Matrix<double, kRows, kRows>>(s.node_block(k)).trace();
      std::fill_n(&held[std::int64_t{k} * kRows], kRows, kHeld * std::abs(trace));
    }
    return s.indefinite(on_frames(shift), held);
  }

 private:
  static constexpr double kGrowth = 3, kDecay = 10, kForgotten = 0.5, kAccepted = 0.05, kGood = 0.5,
                          kUndamped = 0.3, kNothing = 1e-3, kHeld = 1e6;
  using Mixed = Eigen::Matrix<double, kDof, kDof>;
  using Turns = Eigen::Matrix<double, P, Frames::kDof>;

  // M - Lambda, at x; sets Lambda, and the residual.
  GraphMatrix certificate(const std::vector<double>& x) {
    evaluate(x, residual_);
    find_multipliers(x);
    GraphMatrix s = matrix_;
    for (std::int32_t k = 0; k < nodes_; ++k) {
      Eigen::Map<Eigen::Matrix<double, kRows, kRows>> block(s.node_block(k));
      block.template topLeftCorner<D, D>() -= lambda_[k];
    }
    return s;
  }

  std::vector<double> on_frames(double shift) const {
    std::vector<double> out(matrix_.rows());
    for (std::int32_t k = 0; k < nodes_; ++k) {
      std::fill_n(&out[std::int64_t{k} * kRows], D, shift);
    }
    return out;
  }

  Eigen::Map<const Frame> frame(const std::vector<double>& x, std::int32_t k) const {
    return Eigen::Map<const Frame>(&x[std::int64_t{k} * kStep]);
  }

  // Sets the residual M x - F, and returns the cost.
  double evaluate(const std::vector<double>& x, std::vector<double>& residual) const {
    matrix_.multiply(x.data(), P, residual.data());
    double cost = constant_;
    for (std::size_t i = 0; i < x.size(); ++i) {
      cost += x[i] * (residual[i] - 2 * forcing_[i]);
      residual[i] -= forcing_[i];
    }
    return cost;
  }

  // The part of M of the translations, factorized: they have the same one in each of their numbers.
  GraphMatrix laplacian() const {
    GraphMatrix out(matrix_.elimination(), 1);
    const auto entries = static_cast<std::int64_t>(matrix_.pattern().row.size());
    for (std::int64_t e = 0; e < entries; ++e) *out.block(e) = matrix_.block(e)[kRows * kRows - 1];
    (void)out.factorize(std::vector<double>(nodes_));
    return out;
  }

  // Moves the translations to their best for the frames; sets the residual, and returns the cost.
  double settle(const GraphMatrix& translations, std::vector<double>& x,
                std::vector<double>& residual) const {
    evaluate(x, residual);
    std::vector<double> pull(std::int64_t{nodes_} * P);
    for (std::int32_t k = 0; k < nodes_; ++k) {
      std::copy_n(&residual[std::int64_t{k} * kStep + D * P], P, &pull[std::int64_t{k} * P]);
    }
    translations.solve(pull, P);
    for (std::int32_t k = 0; k < nodes_; ++k) {
      for (int i = 0; i < P; ++i) x[std::int64_t{k} * kStep + D * P + i] -= pull[k * P + i];
    }
    return evaluate(x, residual);
  }

  void find_multipliers(const std::vector<double>& x) {
    for (std::int32_t k = 0; k < nodes_; ++k) {
      lambda_[k] = Frames::symmetric(frame(residual_, k), frame(x, k));
    }
  }

  // The coordinates of what a vector a does to the frame: sum over its rows.
  static Turns combine(const typename Frames::Basis& basis, const Eigen::Matrix<double, D, 1>& a) {
    Turns out = a[0] * basis.template topRows<P>();
    for (int i = 1; i < D; ++i) out += a[i] * basis.template middleRows<P>(i * P);
    return out;
  }

  // The gradient's negative half and the half Hessian in the coordinates of the tangent spaces.
  void linearize(const std::vector<double>& x, std::vector<typename Frames::Basis>& basis,
                 std::vector<double>& gradient, GraphMatrix& hessian) {
    find_multipliers(x);
    for (std::int32_t k = 0; k < nodes_; ++k) {
      basis[k] = Frames::basis(frame(x, k));
      const double* const residual = &residual_[std::int64_t{k} * kStep];
      double* const out = &gradient[std::int64_t{k} * kDof];
      Eigen::Map<Eigen::Matrix<double, Frames::kDof, 1>>{out}.noalias() =
          -basis[k].transpose() * Eigen::Map<const Eigen::Matrix<double, D * P, 1>>(residual);
      for (int i = 0; i < P; ++i) out[Frames::kDof + i] = -residual[D * P + i];
    }
    const BlockPattern& pattern = matrix_.pattern();
    using Square = Eigen::Matrix<double, kRows, kRows>;
    for (std::int32_t c = 0; c < nodes_; ++c) {
      for (std::int64_t e = pattern.start[c]; e < pattern.start[c + 1]; ++e) {
        const std::int32_t r = pattern.row[e];
        Square m = Eigen::Map<const Square>(matrix_.block(e));
        if (r == c) m.template topLeftCorner<D, D>() -= lambda_[c];
        typename Frames::Basis turned = Frames::Basis::Zero();
        for (int i = 0; i < D; ++i) {
          for (int j = 0; j < D; ++j) {
            turned.template middleRows<P>(i * P) +=
                m(i, j) * basis[c].template middleRows<P>(j * P);
          }
        }
        Eigen::Map<Mixed> h(hessian.block(e));
        h.template topLeftCorner<Frames::kDof, Frames::kDof>().noalias() =
            basis[r].transpose() * turned;
        h.template topRightCorner<Frames::kDof, P>() =
            combine(basis[r], m.template topRightCorner<D, 1>()).transpose();
        h.template bottomLeftCorner<P, Frames::kDof>() =
            combine(basis[c], m.template bottomLeftCorner<1, D>().transpose());
        h.template bottomRightCorner<P, P>() = m(D, D) * Eigen::Matrix<double, P, P>::Identity();
      }
    }
  }

  void retract(const std::vector<double>& x, const std::vector<typename Frames::Basis>& basis,
               const std::vector<double>& step, std::vector<double>& out) const {
    for (std::int32_t k = 0; k < nodes_; ++k) {
      const double* const d = &step[std::int64_t{k} * kDof];
      const Eigen::Matrix<double, D * P, 1> turn =
          basis[k] * Eigen::Map<const Eigen::Matrix<double, Frames::kDof, 1>>(d);
      double* const to = &out[std::int64_t{k} * kStep];
      Eigen::Map<Frame>{to} =
          Frames::orthonormal(frame(x, k) + Eigen::Map<const Frame>(turn.data()));
      for (int i = 0; i < P; ++i) {
        to[D * P + i] = x[std::int64_t{k} * kStep + D * P + i] + d[Frames::kDof + i];
      }
    }
  }

  const GraphMatrix& matrix_;
  const double* forcing_;
  double constant_;
  std::int32_t nodes_;
  std::vector<typename Frames::Square> lambda_;
  std::vector<double> residual_;
};

}  // namespace masat
