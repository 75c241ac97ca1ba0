// The steps of a map that grows.
#pragma once

#include <Eigen/Cholesky>
#include <chrono>
#include <cmath>
#include <limits>
#include <mutex>
#include <numbers>
#include <unordered_map>
#include <utility>

#include "online/back_substitution.hpp"
#include "online/components.hpp"
#include "online/growing_factor.hpp"
#include "online/growing_graph.hpp"
#include "online/joint_covariance.hpp"
#include "online/online_map.hpp"
#include "online/pending_changes.hpp"
#include "online/relinearization.hpp"

namespace masat {

template <LieGroup Group>
class OnlineMapOf final : public OnlineMap {
 public:
  static constexpr int kDof = Group::kDof, kSize = Group::kSize;
  using Graph = GrowingGraph<Group>;
  using Square = typename Group::Square;
  using Tangent = typename Group::Tangent;

  explicit OnlineMapOf(double tolerance) : tolerance_(tolerance) {
    graph_.add_node(Group{});
    ids_.push_back(0);
    given_.push_back(true);
    points_.push_back(false);
    resize();
    publish_all();
  }

  int dof() const override { return kDof; }
  int pose_size() const override { return kSize; }
  std::int64_t next_edge() const override { return static_cast<std::int64_t>(slot_of_.size()); }
  bool has_edge(std::int64_t number) const override {
    const auto& removals = pending_.removals;
    return number >= 0 && number < next_edge() && slot_of_[number] != kRemoved &&
           std::find(removals.begin(), removals.end(), number) == removals.end();
  }
  std::int32_t find(std::int64_t id) const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto found = index_.find(id);
    return found == index_.end() ? -1 : found->second;
  }

  bool add_node(std::int64_t id, const double* pose, bool is_point) override;
  bool add_edges(std::span<const std::int64_t> pairs, const double* measurements,
                 const double* information, const std::int64_t* numbers) override;
  bool add_sensor_edges(const SensorEdges& edges, std::span<const bool> may_place) override;
  std::vector<std::int64_t> left_out() const override { return left_out_; }
  bool has_sensor_edges() const override {
    return point_count() > 0 || !graph_.node(0).edges.empty();
  }
  bool is_point(std::int32_t node) const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return points_[node] != 0;
  }
  void place_point(std::int32_t node, const double* pose) override {
    graph_.place(node) = {Group::load(pose), Group::load(pose)};
    given_[node] = true;
  }
  bool remove_edges(std::span<const std::int64_t> numbers) override;
  StepSummary update(double budget) override;

  void set_poses(const double* poses) override;
  void start_from(const double* poses) override;
  double exact_chi2() const override;
  void covariances(std::span<const std::int32_t> rows, std::span<const std::int32_t> columns,
                   double* out) override {
    covariance_.write(factor_, rows, columns, out);
  }
  void linearized(std::span<const std::int32_t> nodes, double* out) const override {
    for (const std::int32_t i : nodes) {
      graph_.place(i).linearized.store(out);
      out += kSize;
    }
  }
  void predict(std::span<const std::int32_t> ends, const double* measurements,
               const double* information, double* distances, double* log_determinants) override;
  void edge_chi2(std::span<const std::int64_t> numbers, double* out) const override {
    for (const std::int64_t number : numbers) {
      const std::int32_t slot = slot_of_[number];
      *out++ = slot < 0 ? std::numeric_limits<double>::quiet_NaN() : graph_.edge(slot).chi2;
    }
  }
  std::vector<std::int32_t> roots() const override {
    std::vector<std::int32_t> out(state_.nodes);
    for (std::int32_t i = 0; i < state_.nodes; ++i) out[i] = graph_.node(i).root;
    return out;
  }
  MapContents contents() const override;
  void fill(const MapContents& contents) override;
  std::int64_t bytes_of_factor() const override { return factor_.bytes(); }
  std::int64_t fill_of_factor() const override { return factor_.fill(); }

  std::int32_t nodes() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return state_.nodes;
  }
  std::int32_t point_count() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return state_.points;
  }
  std::vector<std::uint8_t> points() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return {points_.begin(), points_.begin() + state_.nodes};
  }
  std::int64_t edges() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return state_.edges;
  }
  std::vector<std::int64_t> ids() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return {ids_.begin(), ids_.begin() + state_.nodes};
  }
  double chi2() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return state_.chi2;
  }
  std::vector<double> poses() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return state_.poses;
  }
  bool pose(std::int32_t node, double* out) const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (node < 0 || node >= state_.nodes) return false;
    std::copy_n(state_.poses.data() + std::int64_t{node} * kSize, kSize, out);
    return true;
  }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr std::size_t kAhead = 6;  // nodes or edges that are fetched before their turn
  static constexpr std::int32_t kWaiting = -2, kRemoved = -1;  // instead of the slot of an edge

  bool may_be_numbered(std::size_t count, const std::int64_t* numbers) const;
  void wait(std::size_t before, const std::int64_t* numbers);
  void apply_changes();
  bool may_apply(const PendingEdge<Group>& edge) const;
  void apply(const PendingEdge<Group>& edge);
  void apply_removal(std::int64_t number);
  void release_root(std::int32_t root);
  void resize();
  void solve(double cost, StepSummary& summary);
  void solve_all(StepSummary& summary);
  void settle(Clock::time_point deadline, bool limited, StepSummary& summary);
  void reorder_if_worthwhile(StepSummary& summary);
  void evaluate();
  void require_finite_chi2();
  double publish();
  void roll_back();
  void load_poses(const double* poses);
  void start_at_poses();
  void publish_all();
  double reference(double chi2) const;

  double tolerance_;
  double tested_fill_ = 1e5;  // of the factor at the last test of its order, in scalars
  double coarsest_ = 0;       // the largest cost that thresholds referred to since all was solved
  Graph graph_;
  GrowingFactor<Group> factor_;
  BackSubstitution<Group> back_;
  Relinearization<Group> relinearization_;
  Components<Group> components_;
  JointCovariance<Group> covariance_;

  std::unordered_map<std::int64_t, std::int32_t> index_;
  std::vector<std::int64_t> ids_;
  std::vector<std::uint8_t> points_;   // 1 for nodes that are points
  std::vector<char> given_;            // nodes whose pose the caller gave
  std::vector<std::int32_t> slot_of_;  // of each edge by its number
  PendingChanges<Group> pending_;

  bool all_moved_ = false;  // since the last update, by the caller
  // Nodes that have moved, and edges to be evaluated, in the current update.
  std::vector<std::int32_t> moved_, edges_;
  std::vector<std::int64_t> seen_edge_;
  std::int64_t stamp_ = 0;
  // How to undo the current update.
  std::vector<typename Components<Group>::Change> root_log_;
  std::vector<PendingEdge<Group>> removed_log_;
  std::vector<std::int64_t> added_log_;
  std::vector<std::int64_t> left_out_;  // numbers of edges, in the last update

  // The last complete state, for readers.
  struct State {
    std::vector<double> poses;
    std::int32_t nodes = 0, points = 0;
    std::int64_t edges = 0;
    double chi2 = 0;
  };
  mutable std::mutex mutex_;
  State state_;
};

}  // namespace masat

#include "online/online_map_of_contents.hpp"
#include "online/online_map_of_impl.hpp"
