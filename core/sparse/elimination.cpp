#include "sparse/elimination.hpp"

#include <algorithm>
#include <stdexcept>

#include "sparse/ordering.hpp"

namespace masat {
namespace {

std::vector<std::int32_t> free_of(std::span<const bool> fixed) {
  std::vector<std::int32_t> free;
  for (std::size_t node = 0; node < fixed.size(); ++node) {
    if (!fixed[node]) free.push_back(static_cast<std::int32_t>(node));
  }
  return free;
}

}  // namespace

Elimination::Elimination(const Topology& graph, std::span<const bool> fixed,
                         std::span<const std::int32_t> order, Interface interface)
    : free_(free_of(fixed)),
      index_(graph.nodes(), -1),
      joint_(graph.edges().size(), -1),
      pattern_(find_pattern(graph)),
      adjacency_(pattern_),
      tree_(order.empty() ? find_elimination_tree(adjacency_, minimum_degree(adjacency_))
                          : find_elimination_tree(adjacency_, order, interface)) {}

BlockPattern Elimination::find_pattern(const Topology& graph) {
  const auto columns = static_cast<std::int32_t>(free_.size());
  for (std::int32_t c = 0; c < columns; ++c) index_[free_[c]] = c;
  BlockPattern pattern;
  pattern.start.reserve(columns + 1);
  pattern.row.reserve(columns + joint_.size());
  std::vector<std::int64_t> slot(columns, -1);  // of each row, in the current column
  std::vector<std::int32_t> rows;
  for (std::int32_t c = 0; c < columns; ++c) {
    const auto begin = static_cast<std::int64_t>(pattern.row.size());
    pattern.start.push_back(begin);
    pattern.row.push_back(c);
    rows.clear();
    for (const Incidence& i : graph.incident(free_[c])) {
      const std::int32_t r = index_[i.node];
      if (r > c && slot[r] < begin) {
        slot[r] = begin;
        rows.push_back(r);
      }
    }
    std::sort(rows.begin(), rows.end());
    for (std::size_t k = 0; k < rows.size(); ++k) {
      slot[rows[k]] = begin + 1 + static_cast<std::int64_t>(k);
    }
    pattern.row.insert(pattern.row.end(), rows.begin(), rows.end());
    for (const Incidence& i : graph.incident(free_[c])) {
      const std::int32_t r = index_[i.node];
      if (r > c) joint_[i.edge < 0 ? ~i.edge : i.edge] = slot[r];
    }
  }
  pattern.start.push_back(static_cast<std::int64_t>(pattern.row.size()));
  return pattern;
}

const FrontLayout& Elimination::layout(int d) const {
  if (d < 1 || d > kLargestBlock) throw std::invalid_argument("blocks have 1 to 10 rows");
  const std::lock_guard<std::mutex> lock(mutex_);
  std::unique_ptr<FrontLayout>& layout = layouts_[d - 1];
  if (!layout) {
    layout = std::make_unique<FrontLayout>(pattern_, adjacency_, tree_, d, kernels().lanes);
  }
  return *layout;
}

std::int64_t Elimination::fill(int d) const {
  std::int64_t sum = 0;
  for (std::int32_t k = 0; k < tree_.boundary(); ++k) {
    if (!tree_.is_element(k)) sum += d * (std::int64_t{tree_.count[k]} * d) - d * (d - 1) / 2;
  }
  return sum;
}

double Elimination::operations(int d) const {
  double sum = 0;
  for (std::int32_t i = 0; i < tree_.boundary(); ++i) {
    if (tree_.is_element(i)) continue;
    for (int k = 0; k < d; ++k) {
      const double height = double(tree_.count[i]) * d - k;
      sum += height * height;
    }
  }
  return sum;
}

}  // namespace masat
