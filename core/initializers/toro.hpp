// Initial guess by gradient descent over the parameters of a tree: TORO.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <numeric>
#include <span>
#include <vector>

#include "graph/topology.hpp"
#include "initializers/placement.hpp"
#include "lie/group.hpp"

namespace masat {

// Each node's pose is stored in the frame of its parent. An edge acts on the path through the tree
// between its nodes: it turns and shifts the nodes on the path by fractions of its residual that
// grow from zero, where the two sides of the path meet, to the ends. Subtrees that hang from the
// path move along.
template <LieGroup Group>
class TreeDescent {
 public:
  // `poses` holds those of the roots, which stay; `information` a matrix an edge.
  TreeDescent(const Topology& graph, std::span<const TreeLink> links, const double* measurements,
              const double* information, const double* poses)
      : edges_(graph.edges()),
        links_(links),
        z_(measurements, static_cast<std::int64_t>(edges_.size())),
        nodes_(graph.nodes()),
        local_(poses, poses + std::int64_t{Group::kSize} * graph.nodes()),
        weight_(edges_.size()),
        order_(edges_.size()) {
    std::int32_t deepest = 0;
    for (const TreeLink& link : links_) {
      if (link.edge < 0) continue;
      nodes_[link.node].parent = link.parent;
      nodes_[link.node].depth = nodes_[link.parent].depth + 1;
      deepest = std::max(deepest, nodes_[link.node].depth);
      const bool forward = edges_[link.edge].to == link.node;
      propose(Group{}, z_[link.edge], forward ? link.edge : ~link.edge).store(local(link.node));
    }
    from_.steps.resize(deepest);
    to_.steps.resize(deepest);
    weigh(information);
  }

  // One step of each edge, those whose paths reach highest first. The gradient is scaled by the
  // preconditioner and `rate`, but no step goes beyond where the edge's residual is zero.
  void sweep(double rate) {
    for (const std::int32_t k : order_) {
      climb(edges_[k]);
      if (from_.length + to_.length == 0) continue;
      const Pair total = compute_poses(from_) + compute_poses(to_);
      const Group z = z_[k];

      const typename Group::Turn turn(from_.end() * z * to_.end().inverse());
      const double turned = std::min(rate * weight_[k].turn, 1 / total.turn);
      rotate(from_, turn, -turned);
      rotate(to_, turn, turned);

      const Vector gap = (from_.end() * z).translation() - to_.end().translation();
      const double shifted = std::min(rate * weight_[k].shift, 1 / total.shift);
      shift(from_, -shifted * gap);
      shift(to_, shifted * gap);
    }
  }

  void store(double* poses) const {
    std::vector<Group> placed(nodes_.size());
    for (const TreeLink& link : links_) {
      placed[link.node] = Group::load(local(link.node));
      if (link.edge >= 0) placed[link.node] = placed[link.parent] * placed[link.node];
      placed[link.node].store(poses + std::int64_t{Group::kSize} * link.node);
    }
  }

 private:
  using Vector = typename Group::Vector;

  struct Pair {  // one number for rotations, one for translations
    double turn = 0, shift = 0;
    Pair operator+(const Pair& b) const { return {turn + b.turn, shift + b.shift}; }
  };
  struct Node {
    std::int32_t parent = -1, depth = 0;
    Pair slack;  // 1 / (the sum of the weights of the edges whose paths contain it)
  };
  struct Step {
    std::int32_t node;
    Group pose;
  };
  // One side of a path: from an end of the edge up to below the node where the sides meet.
  struct Side {
    std::vector<Step> steps;
    std::int32_t length = 0;
    Group top;  // the pose where the sides meet, which is the frame; or that of the side's root
    const Group& end() const { return length > 0 ? steps.front().pose : top; }
  };

  double* local(std::int32_t node) { return local_.data() + std::int64_t{Group::kSize} * node; }
  const double* local(std::int32_t node) const {
    return local_.data() + std::int64_t{Group::kSize} * node;
  }

  void weigh(const double* information) {
    constexpr int d = Vector::RowsAtCompileTime, dof = Group::kDof;
    std::vector<std::int32_t> top(edges_.size());
    for (std::size_t k = 0; k < edges_.size(); ++k) {
      const Eigen::Map<const typename Group::Square> w(information + std::int64_t{dof} * dof * k);
      weight_[k] = {w.diagonal().template tail<dof - d>().mean(),
                    w.diagonal().template head<d>().mean()};
      climb(edges_[k]);
      top[k] = nodes_[edges_[k].from].depth - from_.length;
      for (const Side* side : {&from_, &to_}) {
        for (std::int32_t i = 0; i < side->length; ++i) {
          Pair& sum = nodes_[side->steps[i].node].slack;
          sum = sum + weight_[k];
        }
      }
    }
    for (Node& node : nodes_) node.slack = {1 / node.slack.turn, 1 / node.slack.shift};
    std::iota(order_.begin(), order_.end(), 0);
    std::stable_sort(order_.begin(), order_.end(),
                     [&](std::int32_t a, std::int32_t b) { return top[a] < top[b]; });
  }

  // Finds the path between the ends of an edge.
  void climb(const Edge& edge) {
    std::int32_t a = edge.from, b = edge.to;
    from_.length = to_.length = 0;
    const auto ascend = [&](Side& side, std::int32_t& node) {
      side.steps[side.length++].node = node;
      node = nodes_[node].parent;
    };
    while (a != b) {
      const std::int32_t lead = nodes_[a].depth - nodes_[b].depth;
      if (lead == 0 && nodes_[a].depth == 0) break;
      if (lead >= 0) ascend(from_, a);
      if (lead <= 0) ascend(to_, b);
    }
    from_.top = a == b ? Group{} : Group::load(local(a));
    to_.top = a == b ? Group{} : Group::load(local(b));
  }

  // Computes the poses of the nodes of a side; returns the sum of their slacks.
  Pair compute_poses(Side& side) const {
    Pair sum;
    const Group* parent = &side.top;
    for (std::int32_t i = side.length; i-- > 0;) {
      Step& step = side.steps[i];
      step.pose = *parent * Group::load(local(step.node));
      parent = &step.pose;
      sum = sum + nodes_[step.node].slack;
    }
    return sum;
  }

  // Turns the nodes of a side, in the frame of its top, and recomputes their positions.
  void rotate(Side& side, const typename Group::Turn& turn, double scale) {
    double fraction = 0;
    const Group* parent = &side.top;
    for (std::int32_t i = side.length; i-- > 0;) {
      Step& step = side.steps[i];
      fraction += nodes_[step.node].slack.turn;
      const Vector t = (*parent * Group::load(local(step.node))).translation();
      step.pose = (turn(scale * fraction) * step.pose).at(t);
      parent = &step.pose;
    }
  }

  // Shifts the nodes of a side, and stores their poses in the tree.
  void shift(Side& side, const Vector& by) {
    double fraction = 0;
    const Group* parent = &side.top;
    for (std::int32_t i = side.length; i-- > 0;) {
      Step& step = side.steps[i];
      fraction += nodes_[step.node].slack.shift;
      step.pose = step.pose.at(step.pose.translation() + fraction * by);
      (parent->inverse() * step.pose).store(local(step.node));
      parent = &step.pose;
    }
  }

  const std::vector<Edge>& edges_;
  std::span<const TreeLink> links_;
  typename Group::Table z_;
  std::vector<Node> nodes_;
  std::vector<double> local_;  // in the frames of the parents; those of roots in the world
  std::vector<Pair> weight_;
  std::vector<std::int32_t> order_;
  Side from_, to_;
};

// TORO: the breadth-first tree, improved by sweeps of decreasing rate. The poses of the roots are
// given.
template <LieGroup Group>
void place_by_toro(const Topology& graph, std::span<const std::int32_t> roots,
                   const double* measurements, const double* information, int sweeps,
                   double* poses) {
  const std::vector<TreeLink> links = graph.tree(roots, {});
  TreeDescent<Group> descent(graph, links, measurements, information, poses);
  for (int k = 1; k <= sweeps; ++k) descent.sweep(1.0 / k);
  descent.store(poses);
}

}  // namespace masat
