// A pose graph with points that changes, with the linearization of each edge.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <vector>

#include "factors/sensor.hpp"
#include "lie/group.hpp"

namespace masat {

// Each node has a pose at which its edges are linearized, and a step from it; the current pose is
// that of the linearization moved by the step. H = sum J' W J and the right-hand side -sum J' W e
// belong to the linearization: the fixed nodes have no part in them. A point is a node of which
// edges measure the position alone; nothing turns it.
template <LieGroup Group>
class GrowingGraph {
 public:
  static constexpr int kDof = Group::kDof;
  using Tangent = typename Group::Tangent;
  using Square = typename Group::Square;

  struct Edge {
    std::int32_t from = -1, to = -1;  // -1 for both if the edge is removed
    bool has_sensor = false;          // whether `sensor` tells more of it
    std::int64_t number = 0;          // by which the caller knows it
    Group measured;
    Square information;
    // At the linearization: derivatives by the steps of both nodes, the residual, and the block
    // J_to' W J_from of H.
    Square from_jacobian, to_jacobian;
    Tangent residual;
    double chi2 = 0;       // at the current poses
    double neglected = 0;  // chi2 of what the linearization neglects at the current poses
    Square joint;
  };

  struct Place {
    Group linearized, pose;
  };

  struct Node {
    Square diagonal;  // blocks of H and of the right-hand side
    Tangent rhs;
    double damping = 0;      // a fraction of the diagonal of H that is added to it
    std::int32_t root = -1;  // the fixed node of the component
    bool stale = false;      // the blocks are to be computed
    bool is_point = false;
    std::vector<std::int32_t> edges;
  };

  std::int32_t size() const { return static_cast<std::int32_t>(nodes_.size()); }
  std::int64_t edge_count() const { return edge_count_; }
  std::int32_t edge_slots() const { return static_cast<std::int32_t>(edges_.size()); }
  Node& node(std::int32_t i) { return nodes_[i]; }
  const Node& node(std::int32_t i) const { return nodes_[i]; }
  Edge& edge(std::int32_t k) { return edges_[k]; }
  const Edge& edge(std::int32_t k) const { return edges_[k]; }
  Place& place(std::int32_t i) { return places_[i]; }
  const Place& place(std::int32_t i) const { return places_[i]; }
  Tangent& step(std::int32_t i) { return step_[i]; }
  const Tangent& step(std::int32_t i) const { return step_[i]; }
  bool is_free(std::int32_t i) const { return nodes_[i].root != i; }
  // Whether a node is a point that nothing measures.
  bool is_lone_point(std::int32_t i) const { return nodes_[i].is_point && nodes_[i].edges.empty(); }
  Sensor<Group> sensor(std::int32_t slot) const {
    return edges_[slot].has_sensor ? sensors_[slot] : Sensor<Group>{};
  }
  std::int32_t other_end(const Edge& e, std::int32_t i) const {
    return e.from == i ? e.to : e.from;
  }

  // The sums over all edges.
  double chi2() const { return chi2_; }
  double neglected() const { return neglected_; }

  std::int32_t add_node(const Group& pose, bool is_point = false) {
    const std::int32_t i = size();
    Node& node = nodes_.emplace_back();
    places_.push_back({pose, pose});
    node.diagonal.setZero();
    node.rhs.setZero();
    node.root = i;
    node.is_point = is_point;
    step_.push_back(Tangent::Zero());
    return i;
  }
  void remove_last_node() {
    nodes_.pop_back();
    places_.pop_back();
    step_.pop_back();
  }

  // Returns the slot of the edge, which stays its own until it is removed.
  std::int32_t add_edge(std::int64_t number, std::int32_t from, std::int32_t to,
                        const Group& measured, const Square& information,
                        const Sensor<Group>& sensor = {}) {
    std::int32_t slot = edge_slots();
    if (unused_.empty()) {
      edges_.emplace_back();
    } else {
      slot = unused_.back();
      unused_.pop_back();
    }
    Edge& e = edges_[slot];
    e.number = number;
    e.from = from;
    e.to = to;
    e.measured = measured;
    e.information = information;
    e.chi2 = e.neglected = 0;
    e.has_sensor = sensor.has_offset || sensor.range_bearing;
    if (e.has_sensor) {
      if (sensors_.size() < edges_.size()) sensors_.resize(edges_.capacity());
      sensors_[slot] = sensor;
    }
    for (const std::int32_t i : {from, to}) nodes_[i].edges.push_back(slot);
    ++edge_count_;
    linearize(slot);
    evaluate(slot);
    return slot;
  }
  void remove_edge(std::int32_t slot) {
    Edge& e = edges_[slot];
    for (const std::int32_t i : {e.from, e.to}) {
      std::erase(nodes_[i].edges, slot);
      nodes_[i].stale = true;
    }
    chi2_ -= e.chi2;
    neglected_ -= e.neglected;
    e.from = e.to = -1;
    unused_.push_back(slot);
    --edge_count_;
  }

  // Computes the linearization of an edge; the blocks of its nodes are stale then.
  void linearize(std::int32_t slot) {
    Edge& e = edges_[slot];
    const Group &a = places_[e.from].linearized, &b = places_[e.to].linearized;
    e.residual = e.has_sensor ? sensor_error(e.measured, a, b, sensors_[slot], e.from_jacobian,
                                             e.to_jacobian)
                              : error(e.measured, a, b, e.from_jacobian, e.to_jacobian);
    e.joint.noalias() = e.to_jacobian.transpose() * (e.information * e.from_jacobian);
    nodes_[e.from].stale = nodes_[e.to].stale = true;
  }

  // Linearizes at the current pose of a node, and computes its edges.
  void relinearize(std::int32_t i) {
    move_linearization(i);
    for (const std::int32_t slot : nodes_[i].edges) linearize(slot);
  }
  // The same without the edges.
  void move_linearization(std::int32_t i) {
    places_[i].linearized = places_[i].pose;
    nodes_[i].damping = 0;
    step_[i].setZero();
  }

  // Computes the blocks of a node if they are stale.
  void refresh(std::int32_t i) {
    Node& node = nodes_[i];
    if (!node.stale) return;
    node.stale = false;
    node.diagonal.setZero();
    node.rhs.setZero();
    for (const std::int32_t slot : node.edges) {
      const Edge& e = edges_[slot];
      const Square& j = e.from == i ? e.from_jacobian : e.to_jacobian;
      const Square weighted = e.information * j;
      node.diagonal.noalias() += j.transpose() * weighted;
      node.rhs.noalias() -= weighted.transpose() * e.residual;
    }
    // The rotation of a point is in no residual.
    if (node.is_point) node.diagonal.diagonal().template tail<kDof - Group::kDimension>().setOnes();
  }

  // Moves a node's pose to that of its linearization and its step.
  void update_pose(std::int32_t i) {
    places_[i].pose = places_[i].linearized * Group::from_tangent(step_[i].data());
  }

  // Fetches what `evaluate` needs of an edge.
  void prefetch(std::int32_t slot) const {
    constexpr std::size_t kLine = 64;
    const auto* const edge = reinterpret_cast<const char*>(&edges_[slot]);
    for (std::size_t k = 0; k < sizeof(Edge); k += kLine) __builtin_prefetch(edge + k);
  }

  // The residual of an edge at the current poses.
  Tangent residual(std::int32_t slot) const {
    const Edge& e = edges_[slot];
    const Group &a = places_[e.from].pose, &b = places_[e.to].pose;
    return e.has_sensor ? sensor_error(e.measured, a, b, sensors_[slot]) : error(e.measured, a, b);
  }

  // Brings chi2 of an edge up to date with the poses of its nodes.
  void evaluate(std::int32_t slot) {
    Edge& e = edges_[slot];
    const Tangent now = residual(slot);
    const Tangent weighted = e.information * now;
    const Tangent missing =
        now - e.residual - e.from_jacobian * step_[e.from] - e.to_jacobian * step_[e.to];
    const double chi2 = now.dot(weighted), neglected = missing.dot(e.information * missing);
    chi2_ += chi2 - e.chi2;
    neglected_ += neglected - e.neglected;
    e.chi2 = chi2;
    e.neglected = neglected;
    // Rounding must not accumulate.
    if (++evaluations_ > kEvaluations * edge_count_) sum_again();
  }

  void sum_again() {
    evaluations_ = 0;
    chi2_ = neglected_ = 0;
    for (const Edge& e : edges_) {
      if (e.from < 0) continue;
      chi2_ += e.chi2;
      neglected_ += e.neglected;
    }
  }

 private:
  static constexpr std::int64_t kEvaluations = 8;  // of each edge between two exact sums

  std::vector<Node> nodes_;
  std::vector<Place> places_;
  std::vector<Tangent> step_;
  std::vector<Edge> edges_;
  std::vector<Sensor<Group>> sensors_;  // by slot; as many as needed
  std::vector<std::int32_t> unused_;
  std::int64_t edge_count_ = 0, evaluations_ = 0;
  double chi2_ = 0, neglected_ = 0;
};

}  // namespace masat
