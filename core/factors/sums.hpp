// What is computed of each factor of a table, and of their sum.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "factors/loss.hpp"
#include "sparse/edge_groups.hpp"

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

// Adds the factors of a group of edges; returns their cost. A function of its own, into which the
// compiler inlines all of a factor.
template <class Factors, class Poses, class System>
[[gnu::noinline]] double add_group(const Factors& factors, const Poses& poses,
                                   const EdgeLosses& losses, System& system, std::int32_t group) {
  double sum = 0;
  for (const EdgeGroups::Entry& entry : system.groups().entries_of(group)) {
    typename System::Adder adder(system, entry);
    sum += factors.linearize(entry.edge, poses, losses, adder);
  }
  return sum;
}

// Sets the system to that of the factors; returns their total cost.
template <class Factors, class Poses, class System>
double linearize(const Factors& factors, const Poses& poses, const EdgeLosses& losses,
                 System& system) {
  return system.assemble(
      [&](std::int32_t group) { return add_group(factors, poses, losses, system, group); });
}

}  // namespace masat
