// What is computed of each factor of a table, and of their sum.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "factors/loss.hpp"

namespace masat {

template <class Factors, class Poses>
void residuals(const Factors& factors, const Poses& poses, double* out) {
  using Tangent = typename Factors::Tangent;
  for (std::int64_t k = 0; k < factors.size(); ++k, out += Tangent::SizeAtCompileTime) {
    Eigen::Map<Tangent>{out} = factors.residual(k, poses);
  }
}

template <class Factors, class Poses>
void costs(const Factors& factors, const Poses& poses, double* out) {
  for (std::int64_t k = 0; k < factors.size(); ++k) out[k] = factors.cost(k, poses);
}

template <class Factors, class Poses>
double total_cost(const Factors& factors, const Poses& poses, const EdgeLosses& losses) {
  double sum = 0;
  for (std::int64_t k = 0; k < factors.size(); ++k) sum += losses.cost(k, factors.cost(k, poses));
  return sum;
}

// Adds the factors to the system; returns their total cost.
template <class Factors, class Poses, class System>
double linearize(const Factors& factors, const Poses& poses, const EdgeLosses& losses,
                 System& system) {
  double sum = 0;
  for (std::int64_t k = 0; k < factors.size(); ++k) {
    sum += factors.linearize(k, poses, losses, system);
  }
  return sum;
}

}  // namespace masat
