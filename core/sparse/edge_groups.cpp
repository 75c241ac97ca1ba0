#include "sparse/edge_groups.hpp"

#include <algorithm>
#include <utility>

namespace masat {
namespace {

// Scalars of blocks, over all edges, for which a group pays: about 0.1 ms of work. With less than
// four groups threads would gain too little.
constexpr std::int64_t kScalarsPerGroup = 16384, kLeastGroups = 4, kMostGroups = 64;

std::int32_t group_count(std::size_t edges, int work) {
  const std::int64_t groups = static_cast<std::int64_t>(edges) * work / kScalarsPerGroup;
  return static_cast<std::int32_t>(groups < kLeastGroups ? 1 : std::min(groups, kMostGroups));
}

// Turns counts at [k + 1] into starts at [k].
void accumulate(std::vector<std::int64_t>& counts) {
  for (std::size_t k = 1; k < counts.size(); ++k) counts[k] += counts[k - 1];
}

}  // namespace

EdgeGroups::EdgeGroups(const Elimination& elimination, std::span<const Edge> edges, int work) {
  const std::vector<std::int32_t>& order = elimination.tree().order;
  const std::vector<std::int32_t>& position = elimination.tree().index;
  const auto nodes = static_cast<std::int32_t>(order.size());
  const std::int32_t groups = group_count(edges.size(), work);
  const auto last = static_cast<std::int32_t>(nodes - 1);
  // The end that is eliminated first, and the other one; both are the same if one node is fixed.
  // Edges between fixed nodes count as those of the last node.
  const auto ends = [&](const Edge& edge) {
    const std::int32_t a = elimination.index(edge.from), b = elimination.index(edge.to);
    const std::int32_t first = a >= 0 ? position[a] : b >= 0 ? position[b] : std::max(last, 0);
    const std::int32_t second = b >= 0 ? position[b] : first;
    return std::minmax({first, second});
  };

  // Ranges of the elimination order with about as many edges.
  std::vector<std::int32_t> group_at(std::max(nodes, 1), 0);
  if (groups > 1) {
    std::vector<std::int64_t> before(nodes + 1, 0);
    for (const Edge& edge : edges) ++before[ends(edge).first + 1];
    accumulate(before);
    for (std::int32_t k = 0; k < nodes; ++k) {
      group_at[k] = static_cast<std::int32_t>(before[k] * groups / (before[nodes] + 1));
    }
  }

  entry_start.assign(groups + 1, 0);
  std::vector<std::int64_t> cells_of(groups > 1 ? nodes + 1 : 1, 0);
  for (const Edge& edge : edges) {
    const auto [first, second] = ends(edge);
    ++entry_start[group_at[first] + 1];
    if (group_at[first] != group_at[second]) ++cells_of[second + 1];
  }
  accumulate(entry_start);
  accumulate(cells_of);

  entries.resize(edges.size());
  std::vector<std::int64_t> next(entry_start.begin(), entry_start.end() - 1);
  for (std::size_t k = 0; k < edges.size(); ++k) {
    const std::int32_t a = elimination.index(edges[k].from), b = elimination.index(edges[k].to);
    const auto joint = static_cast<std::int32_t>(elimination.joint(static_cast<std::int64_t>(k)));
    entries[next[group_at[ends(edges[k]).first]]++] = {
        static_cast<std::int32_t>(k), a >= 0 ? a : kFixed, b >= 0 ? b : kFixed,
        a > b ? ~joint : joint};
  }

  cell_start.assign(groups + 1, 0);
  cell_node.resize(cells_of.back());
  for (std::int32_t k = 0; k + 1 < static_cast<std::int32_t>(cells_of.size()); ++k) {
    cell_start[group_at[k] + 1] = cells_of[k + 1];
    std::fill(cell_node.begin() + cells_of[k], cell_node.begin() + cells_of[k + 1], order[k]);
  }
  for (std::int32_t g = 0; g < groups; ++g) {  // a group may have no nodes
    cell_start[g + 1] = std::max(cell_start[g + 1], cell_start[g]);
  }
  if (cell_node.empty()) return;
  for (Entry& entry : entries) {
    if (entry.from == kFixed || entry.to == kFixed) continue;
    const std::int32_t from = position[entry.from], to = position[entry.to];
    if (group_at[from] == group_at[to]) continue;
    const auto cell = static_cast<std::int32_t>(cells_of[std::max(from, to)]++);
    (from > to ? entry.from : entry.to) = ~cell;
  }
}

}  // namespace masat
