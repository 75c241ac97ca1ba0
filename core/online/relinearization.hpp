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
// of a problem whose residuals differ by r. What moves as a whole without turning neglects nothing.
template <LieGroup Group>
class Relinearization {
 public:
  using Graph = GrowingGraph<Group>;

  // Chooses nodes of the edges with the largest r' W r, until what is left is a fraction of the
  // limit; none if the limit is kept already.
  void choose(const Graph& graph, double limit, double fraction, std::size_t most) {
    clear(graph);
    const auto edges = static_cast<double>(std::max<std::int64_t>(graph.edge_count(), 1));
    least_ = fraction * limit / 2 / edges;
    if (graph.neglected() <= limit) return;
    candidates_.clear();
    double left = 0;
    for (std::int32_t slot = 0; slot < graph.edge_slots(); ++slot) {
      const auto& e = graph.edge(slot);
      if (e.from < 0) continue;
      left += e.neglected;
      if (e.neglected > least_) candidates_.push_back({e.neglected, slot});
    }
    std::sort(candidates_.begin(), candidates_.end(), [](const auto& a, const auto& b) {
      return a.first > b.first || (a.first == b.first && a.second < b.second);
    });
    for (const auto& [neglected, slot] : candidates_) {
      if (left <= fraction * limit || most-- == 0) break;
      left -= neglected;
      const auto& e = graph.edge(slot);
      add(graph, e.from);
      add(graph, e.to);
    }
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

  // Linearizes at the poses of the chosen nodes. Where a neighbor has moved far since its own
  // linearization, an edge between both neglects more than before: then it is chosen, too.
  template <class Factor>
  void apply(Graph& graph, Factor& factor) {
    for (std::size_t done = 0; done < chosen_.size();) {
      const std::size_t begin = done;
      for (; done < chosen_.size(); ++done) graph.move_linearization(chosen_[done]);
      const std::size_t end = done;
      ++edge_stamp_;
      for (std::size_t k = begin; k < end; ++k) {
        for (const std::int32_t slot : graph.node(chosen_[k]).edges) {
          if (seen_edge_[slot] == edge_stamp_) continue;
          seen_edge_[slot] = edge_stamp_;
          graph.linearize(slot);
          graph.evaluate(slot);
          const auto& e = graph.edge(slot);
          factor.touch_values(e.from);
          factor.touch_values(e.to);
          if (e.neglected <= least_) continue;
          add(graph, e.from);
          add(graph, e.to);
        }
      }
    }
  }

  // The same where all neighbors are dropped already.
  void apply_to_dropped(Graph& graph) {
    ++edge_stamp_;
    for (const std::int32_t node : chosen_) graph.move_linearization(node);
    for (const std::int32_t node : chosen_) {
      for (const std::int32_t slot : graph.node(node).edges) {
        if (seen_edge_[slot] == edge_stamp_) continue;
        seen_edge_[slot] = edge_stamp_;
        graph.linearize(slot);
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
  std::int64_t stamp_ = 0, edge_stamp_ = 0;
  double least_ = 0;  // what an edge may neglect, of the last choice
};

}  // namespace masat
