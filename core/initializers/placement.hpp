// Initial guesses by one walk over the graph: along a tree, or MASAT.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "graph/information_queue.hpp"
#include "graph/topology.hpp"
#include "lie/group.hpp"

namespace masat {

// The pose of a node that a neighbor at `pose` and the measurement z between them propose: z leads
// from the neighbor to the node when `edge` >= 0, otherwise from the node to the neighbor.
template <LieGroup Group>
Group propose(const Group& pose, const Group& z, std::int32_t edge) {
  return pose * (edge >= 0 ? z : z.inverse());
}

// The average of the poses that a node's neighbors propose, of which there is at least one. If it
// is not inlined, MASAT takes a tenth longer.
template <LieGroup Group>
[[gnu::always_inline]] inline Group average(std::span<const Incidence> neighbors,
                                            const Group* placed, const typename Group::Table& z) {
  const auto proposal = [&](const Incidence& i) {
    return propose(placed[i.node], z[i.edge >= 0 ? i.edge : ~i.edge], i.edge);
  };
  typename Group::Mean mean(proposal(neighbors[0]));
  for (std::size_t k = 1; k < neighbors.size(); ++k) mean.add(proposal(neighbors[k]));
  return mean.get();
}

// Places each node of the tree from its parent. The poses of the roots are given.
template <LieGroup Group>
void place_along_tree(const Topology& graph, std::span<const TreeLink> links,
                      const double* measurements, double* poses) {
  std::vector<Group> placed(graph.nodes());
  for (const TreeLink& link : links) {
    double* const out = poses + std::int64_t{Group::kSize} * link.node;
    if (link.edge < 0) {
      placed[link.node] = Group::load(out);
      continue;
    }
    const Group z = Group::load(measurements + std::int64_t{Group::kSize} * link.edge);
    const bool forward = graph.edges()[link.edge].to == link.node;
    placed[link.node] = propose(placed[link.parent], z, forward ? link.edge : ~link.edge);
    placed[link.node].store(out);
  }
}

// MASAT: breadth-first from the roots, each node once, at the average of the proposals of its
// neighbors already placed. Neighbors that are still in the queue have no pose and are ignored. The
// poses of the roots are given.
template <LieGroup Group>
void place_by_masat(const Topology& graph, std::span<const std::int32_t> roots,
                    const double* measurements, double* poses) {
  enum State : char { kUnseen, kQueued, kPlaced };
  const auto edges = static_cast<std::int64_t>(graph.edges().size());
  const typename Group::Table z(measurements, edges);
  std::vector<Group> placed(graph.nodes());

  std::vector<State> state(graph.nodes(), kUnseen);
  std::vector<std::int32_t> queue(graph.nodes() + 1);
  std::vector<Incidence> placed_neighbors(graph.max_degree() + 1);
  std::size_t tail = 0;
  for (const std::int32_t root : roots) {
    placed[root] = Group::load(poses + std::int64_t{Group::kSize} * root);
    state[root] = kPlaced;
    queue[tail++] = root;
  }
  for (std::size_t head = 0; head < tail; ++head) {
    const std::int32_t node = queue[head];
    // No branch predictor can tell which neighbors are unseen or placed. So both lists are always
    // written to, and their lengths grow only where the condition is true.
    std::size_t count = 0;
    for (const Incidence& i : graph.incident(node)) {
      State& s = state[i.node];
      queue[tail] = i.node;
      tail += s == kUnseen;
      placed_neighbors[count] = i;
      count += s == kPlaced;
      s = std::max(s, kQueued);
    }
    if (head < roots.size()) continue;
    placed[node] = average<Group>({placed_neighbors.data(), count}, placed.data(), z);
    placed[node].store(poses + std::int64_t{Group::kSize} * node);
    state[node] = kPlaced;
  }
}

// As MASAT, but the next node is the one about which there is most information. A measurement has
// the variance 1, a placed node 1 / (sum of its proposals' information), and a proposal the sum of
// both. The poses of the roots are given and have no variance.
template <LieGroup Group>
void place_most_informed_first(const Topology& graph, std::span<const std::int32_t> roots,
                               const double* measurements, double* poses) {
  const std::size_t edges = graph.edges().size();
  const typename Group::Table z(measurements, static_cast<std::int64_t>(edges));
  std::vector<Group> placed(graph.nodes());
  InformationQueue queue(graph.nodes(), edges);
  std::vector<Incidence> placed_neighbors(graph.max_degree() + 1);
  std::vector<std::int32_t> other_neighbors(graph.max_degree() + 1);

  // Lists the placed neighbors and adds information about the others, without branches as above.
  const auto visit = [&](std::int32_t node, float variance) {
    std::size_t count = 0, others = 0;
    for (const Incidence& i : graph.incident(node)) {
      placed_neighbors[count] = i;
      other_neighbors[others] = i.node;
      const bool known = queue.retired(i.node);
      count += known;
      others += !known;
    }
    const float information = 1 / (variance + 1);
    for (std::size_t k = 0; k < others; ++k) queue.add(other_neighbors[k], information);
    return count;
  };
  for (const std::int32_t root : roots) {
    placed[root] = Group::load(poses + std::int64_t{Group::kSize} * root);
    queue.retire(root);
  }
  for (const std::int32_t root : roots) visit(root, 0);
  for (;;) {
    const auto [node, information] = queue.take();
    if (node < 0) break;
    const std::size_t count = visit(node, 1 / information);
    placed[node] = average<Group>({placed_neighbors.data(), count}, placed.data(), z);
    placed[node].store(poses + std::int64_t{Group::kSize} * node);
  }
}

}  // namespace masat
