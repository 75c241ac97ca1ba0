// The connected components of a growing graph, each with one fixed node: its root.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "online/growing_graph.hpp"

namespace masat {

// The root of a component is the pose of it that was added first, or its only node. Where an edge
// joins two components, that with the older root stays, and the other is moved as a whole to where
// the edge says: its linearization remains valid, since all of it is relative. A point that nothing
// measures joins the poses, whichever is older.
template <LieGroup Group>
class Components {
 public:
  using Graph = GrowingGraph<Group>;

  struct Change {
    std::int32_t node, root;  // before
  };

  // Joins the components of two nodes that an edge is about to join. Returns the root that is no
  // longer fixed, or -1 if both are in one component. `moved` are the nodes that it appends.
  std::int32_t join(Graph& graph, std::int32_t from, std::int32_t to, const Group& measured,
                    bool keep_pose, std::vector<std::int32_t>& moved, std::vector<Change>& log) {
    const std::int32_t from_root = graph.node(from).root, to_root = graph.node(to).root;
    if (from_root == to_root) return -1;
    const bool to_moves = graph.node(to_root).is_point || from_root < to_root;
    const std::int32_t end = to_moves ? to : from;
    const std::int32_t freed = to_moves ? to_root : from_root;
    const std::int32_t kept = to_moves ? from_root : to_root;
    const Group target =
        to_moves ? graph.place(from).pose * measured : graph.place(to).pose * measured.inverse();
    const Group motion = target * graph.place(end).pose.inverse();
    collect(graph, end);
    for (const std::int32_t i : part_) {
      auto& node = graph.node(i);
      log.push_back({i, node.root});
      node.root = kept;
      if (keep_pose) continue;
      auto& place = graph.place(i);
      if (part_.size() == 1) {
        place.linearized = place.pose = normalized(target);
      } else {
        place.linearized = normalized(motion * place.linearized);
        place.pose = normalized(motion * place.pose);
      }
    }
    moved.insert(moved.end(), part_.begin(), part_.end());
    return freed;
  }

  // After the removal of an edge between two nodes of one component: returns the new root of the
  // part that has lost its own, or -1 if they are still connected.
  std::int32_t separate(Graph& graph, std::int32_t a, std::int32_t b, std::vector<Change>& log) {
    if (connected(graph, a, b)) return -1;
    const std::int32_t root = graph.node(a).root;
    collect(graph, a);
    if (std::find(part_.begin(), part_.end(), root) != part_.end()) collect(graph, b);
    const std::int32_t first =
        *std::min_element(part_.begin(), part_.end(), [&graph](std::int32_t i, std::int32_t j) {
          return std::pair(graph.node(i).is_point, i) < std::pair(graph.node(j).is_point, j);
        });
    for (const std::int32_t i : part_) {
      log.push_back({i, graph.node(i).root});
      graph.node(i).root = first;
    }
    return first;
  }

 private:
  // A pose after pose: its heading must not grow with each turn, nor its rotation lose its norm.
  static Group normalized(const Group& pose) {
    double stored[Group::kSize];
    pose.store(stored);
    return Group::load(stored);
  }

  // Sets `part_` to the nodes that are connected to one.
  void collect(const Graph& graph, std::int32_t node) {
    part_.assign(1, node);
    visit(graph.size());
    seen_[node] = stamp_;
    for (std::size_t k = 0; k < part_.size(); ++k) expand(graph, part_[k], part_, stamp_);
  }

  // Searches from both sides in turn, so that a short way round is found soon.
  bool connected(const Graph& graph, std::int32_t a, std::int32_t b) {
    visit(graph.size());
    visit(graph.size());
    const std::int64_t stamps[2] = {stamp_ - 1, stamp_};
    std::vector<std::int32_t>* const sides[2] = {&part_, &other_part_};
    part_.assign(1, a);
    other_part_.assign(1, b);
    seen_[a] = stamps[0];
    seen_[b] = stamps[1];
    for (std::size_t k = 0;; ++k) {
      for (int s = 0; s < 2; ++s) {
        if (k >= sides[s]->size()) return false;
        if (expand(graph, (*sides[s])[k], *sides[s], stamps[s], stamps[1 - s])) return true;
      }
    }
  }

  // Appends the neighbors that have not been seen. Returns whether one has the other stamp.
  bool expand(const Graph& graph, std::int32_t node, std::vector<std::int32_t>& part,
              std::int64_t stamp, std::int64_t other = -1) {
    for (const std::int32_t slot : graph.node(node).edges) {
      const std::int32_t next = graph.other_end(graph.edge(slot), node);
      if (seen_[next] == other) return true;
      if (seen_[next] == stamp) continue;
      seen_[next] = stamp;
      part.push_back(next);
    }
    return false;
  }

  void visit(std::int32_t nodes) {
    if (seen_.size() < static_cast<std::size_t>(nodes)) seen_.resize(nodes, 0);
    ++stamp_;
  }

  std::vector<std::int32_t> part_, other_part_;
  std::vector<std::int64_t> seen_;
  std::int64_t stamp_ = 0;
};

}  // namespace masat
