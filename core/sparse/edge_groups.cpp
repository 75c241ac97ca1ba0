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
  const std::int32_t groups = nodes == 0 ? 1 : group_count(edges.size(), work);
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
  for (const Edge& edge : edges) ++entry_start[group_at[ends(edge).first] + 1];
  accumulate(entry_start);
  entries.resize(edges.size());
  std::vector<bool> seen(elimination.pattern().row.size(), false);
  std::vector<std::int64_t> next(entry_start.begin(), entry_start.end() - 1);
  for (std::size_t k = 0; k < edges.size(); ++k) {
    const std::int32_t a = elimination.index(edges[k].from), b = elimination.index(edges[k].to);
    Entry& entry = entries[next[group_at[ends(edges[k]).first]]++];
    entry = {static_cast<std::int32_t>(k), a >= 0 ? a : kFixed, b >= 0 ? b : kFixed, 0, a > b, 0};
    if (a >= 0 && b >= 0) {
      const std::int64_t joint = elimination.joint(static_cast<std::int64_t>(k));
      entry.joint = static_cast<std::uint32_t>(joint);
      entry.repeated = seen[joint];
      seen[joint] = true;
    }
  }

  const BlockPattern& pattern = elimination.pattern();
  block.assign(pattern.start.begin(), pattern.start.end() - 1);
  cell_start.assign(groups + 1, 0);
  if (groups == 1) return;

  // Calls f(entry, position of the node of another group, group) where an edge has one.
  const auto each_outside = [&](auto f) {
    for (std::int32_t g = 0; g < groups; ++g) {
      for (auto k = entry_start[g]; k < entry_start[g + 1]; ++k) {
        Entry& entry = entries[k];
        if (entry.from == kFixed || entry.to == kFixed) continue;
        const std::int32_t outside = std::max(position[entry.from], position[entry.to]);
        if (group_at[outside] != g) f(entry, outside, g);
      }
    }
  };
  std::vector<std::int64_t> cells(nodes + 1, 0);  // of each position; then its next one
  std::vector<std::int32_t> last_group(nodes, -1);
  each_outside([&](const Entry&, std::int32_t at, std::int32_t g) {
    cells[at + 1] += last_group[at] != g;
    last_group[at] = g;
  });
  accumulate(cells);
  cell_node.resize(cells.back());
  block.reserve(nodes + cell_node.size());
  for (std::int32_t k = 0; k < nodes; ++k) {
    cell_start[group_at[k] + 1] = cells[k + 1];
    std::fill(cell_node.begin() + cells[k], cell_node.begin() + cells[k + 1], order[k]);
  }
  for (std::int32_t g = 0; g < groups; ++g) {  // a group may have no nodes
    cell_start[g + 1] = std::max(cell_start[g + 1], cell_start[g]);
  }
  for (std::size_t c = 0; c < cell_node.size(); ++c) {
    block.push_back(static_cast<std::int32_t>(pattern.row.size() + c));
  }
  std::fill(last_group.begin(), last_group.end(), -1);
  each_outside([&](Entry& entry, std::int32_t at, std::int32_t g) {
    cells[at] += last_group[at] != g;
    last_group[at] = g;
    const auto cell = static_cast<std::int32_t>(nodes + cells[at] - 1);
    (entry.from == order[at] ? entry.from : entry.to) = cell;
  });
}

}  // namespace masat
