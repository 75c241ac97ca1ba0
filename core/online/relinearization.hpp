// Which nodes are to be linearized again.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "online/growing_factor.hpp"
#include "online/growing_graph.hpp"

namespace masat {

// The linearization of an edge at the poses x + d neglects r = e(x + d) - e(x) - J d. To first
// order the sum of r' W r bounds by how much chi2 is above its minimum, since the solution is that
// of a problem whose residuals differ by r. Only relative motion counts: what moves as a whole by
// any way, without a turn, keeps its linearization.
template <LieGroup Group>
class Relinearization {
 public:
  using Graph = GrowingGraph<Group>;

  // Chooses nodes of the edges with the largest r' W r, until what is left is half the limit.
  // `most` bounds their number. Returns whether that was enough.
  bool choose(const Graph& graph, double limit, std::size_t most) {
    chosen_.clear();
    if (graph.neglected() <= limit) return true;
    candidates_.clear();
    const double least = limit / 4 / static_cast<double>(std::max<std::int64_t>(graph.edge_count(), 1));
    double small = 0;
    for (std::int32_t slot = 0; slot < graph.edge_slots(); ++slot) {
      const auto& e = graph.edge(slot);
      if (e.from < 0) continue;
      if (e.neglected > least) {
        candidates_.push_back({e.neglected, slot});
      } else {
        small += e.neglected;
      }
    }
    std::sort(candidates_.begin(), candidates_.end(), [](const auto& a, const auto& b) {
      return a.first > b.first || (a.first == b.first && a.second < b.second);
    });
    double left = small;
    for (const auto& [neglected, slot] : candidates_) left += neglected;
    visit(graph);
    for (const auto& [neglected, slot] : candidates_) {
      if (left <= limit / 2) return true;
      if (chosen_.size() >= most) return false;
      left -= neglected;
      const auto& e = graph.edge(slot);
      add(graph, e.from);
      add(graph, e.to);
    }
    return true;
  }
  // Also those that were damped.
  void add(const Graph& graph, std::int32_t node) {
    if (!graph.is_free(node) || seen_node_[node] == stamp_) return;
    seen_node_[node] = stamp_;
    chosen_.push_back(node);
  }
  void clear(const Graph& graph) {
    chosen_.clear();
    visit(graph);
  }
  const std::vector<std::int32_t>& chosen() const { return chosen_; }

  // Linearizes at the poses of the chosen nodes. With a factor, touches what changes.
  template <class Factor>
  void apply(Graph& graph, Factor* factor) {
    if (chosen_.empty()) return;
    visit(graph);
    for (const std::int32_t node : chosen_) graph.move_linearization(node);
    for (const std::int32_t node : chosen_) {
      for (const std::int32_t slot : graph.node(node).edges) {
        if (seen_edge_[slot] == stamp_) continue;
        seen_edge_[slot] = stamp_;
        graph.linearize(slot);
        if (factor == nullptr) continue;
        factor->touch(graph.edge(slot).from);
        factor->touch(graph.edge(slot).to);
      }
    }
  }

  // Chooses dropped nodes with dropped or fixed neighbors alone, for which nothing else has to be
  // factorized, if one of their edges neglects more than `least`.
  template <class Factor>
  void choose_dropped(const Graph& graph, const Factor& factor, double least) {
    clear(graph);
    for (const std::int32_t node : factor.dropped()) {
      bool worthwhile = false, alone = true;
      for (const std::int32_t slot : graph.node(node).edges) {
        const auto& e = graph.edge(slot);
        const std::int32_t other = graph.other_end(e, node);
        worthwhile |= e.neglected > least;
        alone &= factor.is_dropped(other) || !graph.is_free(other);
      }
      if (worthwhile && alone) add(graph, node);
    }
  }

 private:
  void visit(const Graph& graph) {
    seen_node_.resize(graph.size(), 0);
    seen_edge_.resize(graph.edge_slots(), 0);
    ++stamp_;
  }

  std::vector<std::int32_t> chosen_;
  std::vector<std::pair<double, std::int32_t>> candidates_;
  std::vector<std::int64_t> seen_node_, seen_edge_;
  std::int64_t stamp_ = 0;
};

}  // namespace masat
