// Which nodes the edges join: flat adjacency arrays and the walks over them.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace masat {

struct Edge {
  std::int32_t from, to;
};

// One end of an edge, as seen from the node at its other end.
struct Incidence {
  std::int32_t node;  // the neighbor
  std::int32_t edge;  // >= 0: the edge leads from the neighbor; otherwise ~edge leads to it
};

// How a node was reached by a walk. Roots have edge -1 and parent -1.
struct TreeLink {
  std::int32_t node, parent, edge;
};

class Topology {
 public:
  // A node's incidences keep the order of the edge list.
  Topology(std::int32_t nodes, std::vector<Edge> edges);

  std::int32_t nodes() const { return static_cast<std::int32_t>(start_.size()) - 1; }
  std::int32_t max_degree() const { return max_degree_; }
  const std::vector<Edge>& edges() const { return edges_; }
  std::span<const Incidence> incident(std::int32_t node) const {
    return {incidence_.data() + start_[node], incidence_.data() + start_[node + 1]};
  }

  // Edges, ascending, that touch any flagged node.
  std::vector<std::int64_t> incident_edges(std::span<const bool> nodes) const;

  // Component of each node, numbered in the order of their smallest node.
  std::vector<std::int32_t> components() const;

  // Tree of the shortest paths from the roots, in the order of the visit. An edge for which
  // `preferred` is true has length 0, any other 1; an empty `preferred` is the plain breadth-first
  // tree. Nodes that no root reaches are left out.
  std::vector<TreeLink> tree(std::span<const std::int32_t> roots,
                             std::span<const bool> preferred) const;

 private:
  std::vector<Edge> edges_;
  std::vector<std::int64_t> start_;
  std::vector<Incidence> incidence_;
  std::int32_t max_degree_ = 0;
};

}  // namespace masat
