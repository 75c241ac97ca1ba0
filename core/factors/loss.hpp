// Losses: what a robust cost makes of an edge's chi2.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>

namespace masat {

// Formulas and sources: src/masat/optimizers/losses.py.
enum class LossKind { kCauchy, kGemanMcClure, kHuber, kTukey, kDcs, kTruncated };

// A part of the cost, and its derivative with respect to chi2: the weight of the edge's information
// in iteratively reweighted least squares.
struct LossValue {
  double cost, weight;
};

// Of one edge: about chi2 where chi2 is small; the cost's growth ends or slows near scale^2.
class Loss {
 public:
  // `mu` matters to kTruncated alone: 0 is the convex limit, infinity the truncated chi2 itself.
  Loss(LossKind kind, double scale, double mu = std::numeric_limits<double>::infinity())
      : kind_(kind), squared_(scale * scale), mu_(mu), full_(std::isinf(mu) ? 1 : mu / (mu + 1)) {}

  // Not inlined: the loop over the edges of plain least squares stays small.
  [[gnu::noinline]] LossValue operator()(double chi2) const {
    const double u = chi2 / squared_;
    switch (kind_) {
      case LossKind::kCauchy:
        return {squared_ * std::log1p(u), 1 / (1 + u)};
      case LossKind::kGemanMcClure: {
        const double w = 1 / (1 + u);
        return {chi2 * w, w * w};
      }
      case LossKind::kHuber: {
        if (u <= 1) return {chi2, 1};
        const double root = std::sqrt(u);
        return {squared_ * (2 * root - 1), 1 / root};
      }
      case LossKind::kTukey: {
        if (u >= 1) return {squared_ / 3, 0};
        const double left = 1 - u;
        return {chi2 * (1 - u + u * u / 3), left * left};
      }
      case LossKind::kDcs: {
        if (u <= 1) return {chi2, 1};
        const double s = 2 / (1 + u);
        return {squared_ * (3 - 2 * s), s * s};
      }
      case LossKind::kTruncated:
        break;
    }
    if (u <= full_) return {chi2, 1};
    if (u * full_ >= 1) return {squared_, 0};
    // Between the two, a finite mu; sqrt(mu (mu + 1)) = (mu + 1) sqrt(full).
    const double root = (mu_ + 1) * std::sqrt(full_ / u);
    return {squared_ * (2 * u * root - mu_ * (1 + u)), root - mu_};
  }

 private:
  LossKind kind_;
  double squared_, mu_;
  double full_;  // the largest chi2 / scale^2 to which kTruncated gives the weight 1
};

// The losses of all edges of a table. One type serves all of them: a second instance of the loop
// over the edges makes the compiler inline less of both, which costs half of their speed.
class EdgeLosses {
 public:
  // chi2 itself.
  EdgeLosses() = default;
  // chi2 times the weight of the edge.
  explicit EdgeLosses(std::span<const double> weights) : weights_(weights) {}
  // The loss, but chi2 itself where an edge is trusted; without a mask none is.
  EdgeLosses(const Loss& loss, std::span<const bool> trusted) : loss_(loss), trusted_(trusted) {}

  // Whether the loss applies to the edge. If not, its cost is its weight times chi2.
  bool robust(std::int64_t edge) const { return loss_ && (trusted_.empty() || !trusted_[edge]); }
  const Loss& loss() const { return *loss_; }
  double weight(std::int64_t edge) const { return weights_.empty() ? 1.0 : weights_[edge]; }

  double cost(std::int64_t edge, double chi2) const {
    return robust(edge) ? loss()(chi2).cost : weight(edge) * chi2;
  }

 private:
  std::optional<Loss> loss_;
  std::span<const double> weights_;  // what the spans show must outlive the losses
  std::span<const bool> trusted_;
};

}  // namespace masat
