// The translations that minimize chi2 at given rotations.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "factors/loss.hpp"
#include "factors/normal_system.hpp"
#include "factors/sums.hpp"
#include "graph/topology.hpp"
#include "lie/group.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

// The part of the normal equations that belongs to the translations.
template <LieGroup Group>
class TranslationSystem {
 public:
  static constexpr int d = Group::kDimension;

  TranslationSystem(GraphMatrix& matrix, std::span<const Edge> edges) : inner_(matrix, edges) {}
  std::vector<double> take_rhs() && { return std::move(inner_).take_rhs(); }
  const EdgeGroups& groups() const { return inner_.groups(); }
  template <class Add>
  double assemble(Add add) {
    return inner_.assemble(add);
  }

  class Adder {
   public:
    Adder(TranslationSystem& system, const EdgeGroups::Entry& entry)
        : inner_(system.inner_, entry) {}
    void add_edge(const typename Group::Square& from, const typename Group::Square& to,
                  const typename Group::Square& w, const typename Group::Tangent& we) {
      inner_.add_edge(from.template topLeftCorner<d, d>(), to.template topLeftCorner<d, d>(),
                      w.template topLeftCorner<d, d>(), we.template head<d>());
    }

   private:
    typename NormalSystem<d>::Adder inner_;
  };

 private:
  NormalSystem<d> inner_;
};

// Sets the system of the translations in the body frames, from those that the poses have; returns
// its right-hand side. The blocks of the matrix have a row a coordinate.
template <LieGroup Group, class Factors>
std::vector<double> assemble_translations(const Factors& factors, GraphMatrix& matrix,
                                          const typename Group::Table& poses) {
  TranslationSystem<Group> system(matrix, factors.edges());
  linearize(factors, poses, EdgeLosses(), system);
  return std::move(system).take_rhs();
}

// Moves the poses of the free nodes. Residuals are linear in the translations: one Gauss-Newton
// step in them is exact. Leaves its system in the matrix. Returns -1, or the node whose translation
// is not determined.
template <LieGroup Group, class Factors>
std::int32_t solve_translations(const Factors& factors, GraphMatrix& matrix, double* poses) {
  const typename Group::Table pose(poses, matrix.elimination()->nodes());
  std::vector<double> step = assemble_translations<Group>(factors, matrix, pose);
  const std::vector<double> undamped(step.size());
  const std::span<const std::int32_t> free = matrix.elimination()->free_nodes();
  const std::int32_t failed = matrix.factorize(undamped);
  if (failed >= 0) return free[failed];
  matrix.solve(step);
  const double* own = step.data();
  for (const std::int32_t node : free) {
    double tangent[Group::kDof] = {};
    for (int i = 0; i < Group::kDimension; ++i) tangent[i] = *own++;
    (pose[node] * Group::from_tangent(tangent)).store(poses + std::int64_t{Group::kSize} * node);
  }
  return -1;
}

}  // namespace masat
