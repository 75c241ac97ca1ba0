// What is computed of each factor of a table, and of their sum.
#pragma once

#include <Eigen/Core>
#include <cstdint>

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

template <class Factors, class Poses, class Loss>
double total_cost(const Factors& factors, const Poses& poses, const Loss& loss) {
  double sum = 0;
  for (std::int64_t k = 0; k < factors.size(); ++k) sum += loss(k, factors.cost(k, poses)).cost;
  return sum;
}

// Adds the factors to the system; returns their total cost.
template <class Factors, class Poses, class Loss, class System>
double linearize(const Factors& factors, const Poses& poses, const Loss& loss, System& system) {
  double sum = 0;
  for (std::int64_t k = 0; k < factors.size(); ++k) {
    sum += factors.linearize(k, poses, loss, system);
  }
  return sum;
}

}  // namespace masat
