#include "graph/topology.hpp"

#include <algorithm>
#include <deque>

namespace masat {

Topology::Topology(std::int32_t nodes, std::vector<Edge> edges)
    : edges_(std::move(edges)), start_(nodes + 1, 0), incidence_(2 * edges_.size()) {
  for (const Edge& e : edges_) {
    ++start_[e.from];
    ++start_[e.to];
  }
  max_degree_ = static_cast<std::int32_t>(*std::max_element(start_.begin(), start_.end()));
  std::int64_t total = 0;
  for (std::int64_t& count : start_) total += count, count = total;
  // Filling from the back leaves start_ at each node's first incidence, in edge order.
  for (auto k = static_cast<std::int32_t>(edges_.size()); k-- > 0;) {
    const Edge& e = edges_[k];
    incidence_[--start_[e.from]] = {e.to, ~k};
    incidence_[--start_[e.to]] = {e.from, k};
  }
}

std::vector<std::int64_t> Topology::incident_edges(std::span<const bool> nodes) const {
  std::vector<std::int64_t> out;
  for (std::int32_t node = 0; node < this->nodes(); ++node) {
    if (!nodes[node]) continue;
    for (const Incidence& i : incident(node)) {
      // An edge between two flagged nodes is taken where it ends, not where it begins.
      const bool leads_here = i.edge >= 0;
      if (nodes[i.node] && !leads_here) continue;
      out.push_back(leads_here ? i.edge : ~i.edge);
    }
  }
  std::sort(out.begin(), out.end());
  return out;
}

std::vector<std::int32_t> Topology::components() const {
  std::vector<std::int32_t> label(nodes(), -1), stack;
  std::int32_t count = 0;
  for (std::int32_t root = 0; root < nodes(); ++root) {
    if (label[root] >= 0) continue;
    label[root] = count;
    stack.push_back(root);
    while (!stack.empty()) {
      const std::int32_t node = stack.back();
      stack.pop_back();
      for (const Incidence& i : incident(node)) {
        if (label[i.node] >= 0) continue;
        label[i.node] = count;
        stack.push_back(i.node);
      }
    }
    ++count;
  }
  return label;
}

std::vector<TreeLink> Topology::tree(std::span<const std::int32_t> roots,
                                     std::span<const bool> preferred) const {
  std::vector<TreeLink> links;
  links.reserve(nodes());
  std::vector<char> visited(nodes(), 0);
  std::deque<TreeLink> queue;
  const auto visit = [&](const TreeLink& link) {
    links.push_back(link);
    for (const Incidence& i : incident(link.node)) {
      if (visited[i.node]) continue;
      const std::int32_t edge = i.edge < 0 ? ~i.edge : i.edge;
      if (!preferred.empty() && preferred[edge]) {
        queue.push_front({i.node, link.node, edge});
      } else {
        queue.push_back({i.node, link.node, edge});
      }
    }
  };
  for (const std::int32_t root : roots) visited[root] = 1;
  for (const std::int32_t root : roots) visit({root, -1, -1});
  while (!queue.empty()) {
    const TreeLink link = queue.front();
    queue.pop_front();
    if (visited[link.node]) continue;
    visited[link.node] = 1;
    visit(link);
  }
  return links;
}

}  // namespace masat
