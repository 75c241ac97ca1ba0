// The Gauss-Newton system of a graph: H step = -gradient / 2, H = sum J' W J over the factors.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <numeric>
#include <span>
#include <utility>
#include <vector>

#include "factors/loss.hpp"
#include "factors/normal_system.hpp"
#include "factors/relative_pose.hpp"
#include "factors/sums.hpp"
#include "graph/topology.hpp"
#include "lie/group.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

// What the optimizers see, whatever the group. Poses are flat arrays of all nodes, steps and
// gradients flat arrays of the free ones; chi2 is the sum of e' W e, without a factor 1/2.
class NormalEquations {
 public:
  virtual ~NormalEquations() = default;
  virtual int dof() const = 0;
  virtual int pose_size() const = 0;
  virtual std::int32_t nodes() const = 0;
  virtual std::int64_t factors() const = 0;
  virtual std::span<const std::int32_t> free_nodes() const = 0;

  // The sum of the losses of e' W e, in the same order as linearize adds them.
  virtual double cost(const double* poses, const EdgeLosses& losses) = 0;
  // Sets H and the gradient's negative half at `poses`; returns the cost there.
  virtual double linearize(const double* poses, const EdgeLosses& losses) = 0;
  virtual std::span<const double> rhs() const = 0;
  virtual void diagonal(double* out) const = 0;
  virtual void multiply(const double* v, double* out) const = 0;  // H v
  // Factorizes H plus a diagonal; returns -1, or the node at which it is not positive definite.
  // `elements` are those of the elimination, in its order.
  [[nodiscard]] virtual std::int32_t factorize(std::span<const double> damping,
                                               std::span<const Element> elements = {}) = 0;
  // The smallest ratio of a pivot to its diagonal entry of H plus the damping; 1 without unknowns.
  virtual double pivot_ratio() const = 0;
  virtual void solve(double* step) const = 0;
  // Of a part of a graph: what its elimination leaves of H and of a right-hand side at the
  // boundary, and the solution for given values there.
  virtual std::vector<double> contribution() const = 0;
  virtual void reduce(std::span<double> rhs) const = 0;
  virtual void substitute(std::span<double> x) const = 0;
  virtual const Elimination& elimination() const = 0;
  // Blocks of the inverse of the factorized matrix, by indices among the free nodes, each
  // row-major.
  virtual void inverse(std::span<const std::int32_t> rows, std::span<const std::int32_t> columns,
                       double* out) const = 0;
  virtual void retract(const double* poses, const double* step, double* out) const = 0;
};

template <LieGroup Group, class Factors = RelativePoseFactors<Group>>
class NormalEquationsOf : public NormalEquations {
 public:
  static constexpr int kDof = Group::kDof, kSize = Group::kSize;

  // Fixed nodes keep their poses and are not part of the system. The factors have one edge of the
  // graph each. The numbers do not depend on how many threads work.
  NormalEquationsOf(Factors factors, std::shared_ptr<const Elimination> elimination, int threads)
      : factors_(std::move(factors)),
        matrix_(std::move(elimination), kDof, threads),
        system_(matrix_, factors_.edges()) {}
  // The system refers to the matrix.
  NormalEquationsOf(const NormalEquationsOf&) = delete;

  int dof() const override { return kDof; }
  int pose_size() const override { return kSize; }
  std::int32_t nodes() const override { return elimination().nodes(); }
  std::int64_t factors() const override { return factors_.size(); }
  std::span<const std::int32_t> free_nodes() const override { return elimination().free_nodes(); }
  std::span<const double> rhs() const override { return system_.rhs(); }

  double cost(const double* poses, const EdgeLosses& losses) override {
    const WorkerPool::Session session(matrix_.pool());
    set_poses(poses);
    const EdgeGroups& groups = system_.groups();
    sums_.resize(groups.count());
    matrix_.pool().for_each(groups.count(), [&](std::int32_t group, int) {
      double sum = 0;
      for (const EdgeGroups::Entry& entry : groups.entries_of(group)) {
        sum += losses.cost(entry.edge, factors_.cost(entry.edge, poses_));
      }
      sums_[group] = sum;
    });
    return std::accumulate(sums_.begin(), sums_.end(), 0.0);
  }

  double linearize(const double* poses, const EdgeLosses& losses) override {
    const WorkerPool::Session session(matrix_.pool());
    set_poses(poses);
    return masat::linearize(factors_, poses_, losses, system_);
  }

  void diagonal(double* out) const override { matrix_.diagonal(out); }
  void multiply(const double* v, double* out) const override { matrix_.multiply(v, 1, out); }

  [[nodiscard]] std::int32_t factorize(std::span<const double> damping,
                                       std::span<const Element> elements = {}) override {
    const std::int32_t failed = matrix_.factorize(damping, elements);
    return failed < 0 ? -1 : free_nodes()[failed];
  }

  double pivot_ratio() const override { return matrix_.pivot_ratio(); }

  void solve(double* step) const override {
    std::copy(rhs().begin(), rhs().end(), step);
    matrix_.solve({step, rhs().size()});
  }

  std::vector<double> contribution() const override { return matrix_.contribution(); }
  void reduce(std::span<double> rhs) const override { matrix_.reduce(rhs); }
  void substitute(std::span<double> x) const override { matrix_.substitute(x); }
  const Elimination& elimination() const override { return *matrix_.elimination(); }

  void inverse(std::span<const std::int32_t> rows, std::span<const std::int32_t> columns,
               double* out) const override {
    matrix_.inverse(rows, columns, out);
  }

  void retract(const double* poses, const double* step, double* out) const override {
    const WorkerPool::Session session(matrix_.pool());
    matrix_.pool().for_chunks(nodes(), kNodesPerTask, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t node = begin; node < end; ++node) {
        const double* const pose = poses + kSize * node;
        const std::int32_t index = elimination().index(static_cast<std::int32_t>(node));
        if (index < 0) {
          std::copy_n(pose, kSize, out + kSize * node);
        } else {
          const double* const tangent = step + std::int64_t{kDof} * index;
          (Group::load(pose) * Group::from_tangent(tangent)).store(out + kSize * node);
        }
      }
    });
  }

 private:
  // Poses that a task computes: some ten microseconds of work.
  static constexpr std::int64_t kNodesPerTask = 512;

  void set_poses(const double* poses) {
    poses_.view(poses, nodes());
    matrix_.pool().for_chunks(nodes(), kNodesPerTask, [&](std::int64_t begin, std::int64_t end) {
      poses_.prepare(begin, end);
    });
  }

  Factors factors_;
  typename Group::Table poses_;  // those of the last evaluation
  GraphMatrix matrix_;
  NormalSystem<kDof> system_;
  std::vector<double> sums_;
};

}  // namespace masat
