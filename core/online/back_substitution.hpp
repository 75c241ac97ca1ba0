// The solution of a growing factor's system, computed again where it changes.
// Kaess and others, iSAM2 (IJRR 2012), section 4.2, with a threshold in the units of chi2.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <vector>

#include "online/growing_factor.hpp"

namespace masat {

template <LieGroup Group>
class BackSubstitution {
 public:
  static constexpr int kDof = Group::kDof;
  using Graph = GrowingGraph<Group>;
  using Factor = GrowingFactor<Group>;
  using Tangent = typename Group::Tangent;

  void resize(std::int32_t nodes) {
    known_.resize(nodes);
    spreads_.resize(nodes, 0);
  }
  // After a node's step has been set otherwise.
  void know(const Graph& graph, std::int32_t node) {
    known_[node].below = known_[node].evaluated = graph.step(node);
  }

  // Takes the weights of nodes from the newest fronts, whose steps are set otherwise.
  void weigh_newest(const Graph& graph, const Factor& factor) {
    for (const std::int32_t f : factor.newest()) weigh(graph, factor.front(f));
  }

  // Sets the steps of the newest fronts. The other fronts follow where a step above them differs
  // by d from the one that they know, with d' diag(H) d above the threshold; the sum over the nodes
  // bounds by how much chi2 of the linearized problem may be too high. Edges are to be evaluated
  // again where a step has changed by more than another threshold, in the same units.
  void run(Graph& graph, const Factor& factor, double threshold, double evaluation) {
    threshold_ = threshold;
    evaluation_ = evaluation;
    changed_.clear();
    spreading_.clear();
    moved_.clear();
    queue_.clear();
    const auto newest = factor.newest();
    for (auto f = newest.rbegin(); f != newest.rend(); ++f) {
      weigh(graph, factor.front(*f));
      solve(graph, factor.front(*f));
    }
    // Children that are new are among the newest.
    for (const std::int32_t f : newest) visit_children(factor, f);
    for (std::size_t k = 0; k < queue_.size(); ++k) {
      solve(graph, factor.front(queue_[k]));
      visit_children(factor, queue_[k]);
    }
    for (const std::int32_t node : spreading_) spreads_[node] = 0;
  }

  // Nodes whose step changed in the last run.
  const std::vector<std::int32_t>& changed() const { return changed_; }
  // Nodes whose edges are to be evaluated again.
  const std::vector<std::int32_t>& moved() const { return moved_; }

 private:
  // What is known of a node's step, and diag(H).
  struct Known {
    Tangent below = Tangent::Zero();      // to the fronts below it
    Tangent evaluated = Tangent::Zero();  // at the last evaluation of its edges
    Tangent weight = Tangent::Zero();
  };

  void weigh(const Graph& graph, const typename Factor::OwnFront& front) {
    for (std::int32_t k = 0; k < front.pivots; ++k) {
      const std::int32_t node = front.nodes[k];
      known_[node].weight = graph.node(node).diagonal.diagonal();
    }
  }
  // Most fronts lie far apart, and their turn comes later.
  static void prefetch(const typename Factor::OwnFront& front) {
    constexpr int kLine = 8, kLines = 8;
    for (int k = 0; k < kLines; ++k) __builtin_prefetch(front.dense.l11 + k * kLine);
    __builtin_prefetch(front.reciprocal);
    __builtin_prefetch(front.solved);
  }
  void solve(Graph& graph, const typename Factor::OwnFront& front);
  void visit_children(const Factor& factor, std::int32_t f);

  std::vector<Known> known_;
  std::vector<char> spreads_;  // whether the fronts below a node are to follow
  std::vector<std::int32_t> spreading_, changed_, moved_, queue_;
  double threshold_ = 0, evaluation_ = 0;
  std::vector<double> space_;
  const Kernels& kernels_ = kernels();
};

template <LieGroup Group>
void BackSubstitution<Group>::solve(Graph& graph, const typename Factor::OwnFront& front) {
  const Front& dense = front.dense;
  constexpr std::int64_t kLine = 8;
  space_.resize(dense.ld11 + dense.ld21 + 2 * kLine);
  double* x = space_.data();
  x += (kLine - reinterpret_cast<std::uintptr_t>(x) / sizeof(double) % kLine) % kLine;
  double* const y = x + (dense.ld11 + kLine - 1) / kLine * kLine;
  std::copy(front.solved, front.solved + dense.ld11, x);
  double* to = y;
  for (const std::int32_t node : front.rows()) {
    Eigen::Map<Tangent>{to} = graph.step(node);
    to += kDof;
  }
  std::fill(to, y + dense.ld21, 0.0);
  kernels_.backward(dense, front.reciprocal, x, y);
  for (std::int32_t k = 0; k < front.pivots; ++k) {
    const std::int32_t node = front.nodes[k];
    const Eigen::Map<const Tangent> step(x + std::int64_t{k} * kDof);
    if (step == graph.step(node)) continue;
    graph.step(node) = step;
    changed_.push_back(node);
    Known& known = known_[node];
    if ((step - known.below).cwiseAbs2().dot(known.weight) > threshold_) {
      known.below = step;
      spreads_[node] = 1;
      spreading_.push_back(node);
    }
    if ((step - known.evaluated).cwiseAbs2().dot(known.weight) > evaluation_) {
      known.evaluated = step;
      moved_.push_back(node);
    }
  }
}

// A front must be solved again if a step in its rows has changed. Then its parent has been, too.
template <LieGroup Group>
void BackSubstitution<Group>::visit_children(const Factor& factor, std::int32_t f) {
  const auto& children = factor.front(f).children;
  for (const std::int32_t c : children) __builtin_prefetch(factor.front(c).nodes.data());
  for (const std::int32_t c : children) {
    if (factor.is_newest(c)) continue;
    const auto& child = factor.front(c);
    for (const std::int32_t node : child.rows()) {
      if (!spreads_[node]) continue;
      queue_.push_back(c);
      prefetch(child);
      break;
    }
  }
}

}  // namespace masat
