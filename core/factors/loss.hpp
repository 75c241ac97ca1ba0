// Losses: what a robust cost makes of an edge's chi2.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
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
      : kind_(kind),
        squared_(scale * scale),
        mu_(mu),
        // mu / (mu + 1), and its square root.
        full_(std::isinf(mu) ? 1 : mu / (mu + 1)) {}

  LossValue operator()(double chi2) const {
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
  double full_;  // the largest chi2 / scale^2 that kTruncated leaves its full weight
};

// The losses of all edges: one for those that are not trusted, chi2 itself for the others.
class EdgeLosses {
 public:
  // Without a mask none is trusted. The mask must outlive the losses.
  EdgeLosses(const Loss& loss, std::span<const bool> trusted) : loss_(loss), trusted_(trusted) {}

  LossValue operator()(std::int64_t edge, double chi2) const {
    if (!trusted_.empty() && trusted_[edge]) return {chi2, 1};
    return loss_(chi2);
  }

 private:
  Loss loss_;
  std::span<const bool> trusted_;
};

// Factors of the edges' information, one an edge; without any, 1.
class EdgeWeights {
 public:
  explicit EdgeWeights(std::span<const double> weights = {}) : weights_(weights) {}

  LossValue operator()(std::int64_t edge, double chi2) const {
    const double w = weights_.empty() ? 1.0 : weights_[edge];
    return {w * chi2, w};
  }

 private:
  std::span<const double> weights_;
};

}  // namespace masat
