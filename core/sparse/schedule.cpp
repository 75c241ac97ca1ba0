#include "sparse/schedule.hpp"

#include <algorithm>
#include <numeric>
#include <span>
#include <thread>

namespace masat {
namespace {

// A front of at least this many operations is worth sharing: its work outweighs the time for which
// the threads wait for each other.
constexpr double kShared = 2e6;

// The numbers do not depend on the threads. Beyond this limit more of them only take memory.
int limit_threads(int asked) {
  return std::clamp(asked, 1, std::max<int>(std::thread::hardware_concurrency(), 64));
}

// Estimated floating-point operations of a front, with its assembly.
double front_cost(const FrontLayout& layout, std::int32_t f) {
  const double pivots = layout.shape(f).pivots, rows = layout.shape(f).rows;
  return pivots * (pivots * pivots / 3 + rows * (pivots + rows)) + 4 * rows * rows + 4000;
}

std::vector<double> subtree_costs(const FrontLayout& layout) {
  std::vector<double> cost(layout.fronts(), 0);
  for (std::int32_t f = 0; f < layout.fronts(); ++f) {
    cost[f] += front_cost(layout, f);
    const std::int32_t parent = layout.tree().parent[f];
    if (parent >= 0) cost[parent] += cost[f];
  }
  return cost;
}

// Two stacks, for even and odd depths in the tree: the block of a front is put on one while those
// of its children lie on top of the other, so that no block has to move.
class Stacks {
 public:
  Stacks(const FrontLayout& layout, std::span<const std::int32_t> depth, Schedule& schedule)
      : layout_(layout), depth_(depth), schedule_(schedule) {}

  // Assigns offsets to the blocks of `fronts`, a postorder, for which `stacked` is true; returns
  // the size of the workspace.
  template <class Stacked>
  std::int64_t lay_out(std::span<const std::int32_t> fronts, Stacked stacked) {
    std::int64_t top[2] = {0, 0}, size[2] = {0, 0};
    for (const std::int32_t f : fronts) {
      const int side = depth_[f] % 2;
      if (stacked(f)) {
        schedule_.contribution[f] = top[side];
        top[side] += layout_.contribution_size(f);
        size[side] = std::max(size[side], top[side]);
      }
      for (const std::int32_t c : layout_.children(f)) {
        if (stacked(c)) top[1 - side] -= layout_.contribution_size(c);
      }
    }
    size[0] = (size[0] + 7) / 8 * 8;
    for (const std::int32_t f : fronts) {
      if (stacked(f) && depth_[f] % 2 == 1) schedule_.contribution[f] += size[0];
    }
    return size[0] + size[1];
  }

 private:
  const FrontLayout& layout_;
  std::span<const std::int32_t> depth_;
  Schedule& schedule_;
};

}  // namespace

Schedule::Schedule(const FrontLayout& layout, int asked_threads) {
  const int allowed = limit_threads(asked_threads);
  const std::int32_t n = layout.fronts();
  const std::vector<std::int32_t>& parent = layout.tree().parent;
  const std::vector<double> cost = subtree_costs(layout);
  double total = 0;
  for (std::int32_t f = 0; f < n; ++f) total += parent[f] < 0 ? cost[f] : 0;

  // A subtree is the largest that still lets the threads be balanced.
  const double limit = allowed > 1 ? total / (8 * allowed) : 0;
  std::int32_t most_tasks = 1;
  std::vector<std::int32_t> depth(n, 0), subtree_of(n, -1);
  for (std::int32_t f = n - 1; f >= 0; --f) {
    if (parent[f] >= 0) depth[f] = depth[parent[f]] + 1;
    if (parent[f] >= 0 && subtree_of[parent[f]] >= 0) {
      subtree_of[f] = subtree_of[parent[f]];
      subtrees[subtree_of[f]].first = f;
    } else if (cost[f] <= limit) {
      subtree_of[f] = static_cast<std::int32_t>(subtrees.size());
      subtrees.push_back({f, f});
    } else {
      const bool shared = allowed > 1 && front_cost(layout, f) > kShared;
      top.push_back({f, shared});
      const std::int32_t rows = layout.shape(f).pivots + layout.shape(f).rows;
      if (shared) most_tasks = std::max(most_tasks, rows / Kernels::kTile);
    }
  }
  threads = std::min(allowed, std::max(most_tasks, static_cast<std::int32_t>(subtrees.size())));
  std::reverse(top.begin(), top.end());

  contribution.assign(n, 0);
  in_common.assign(n, false);
  Stacks stacks(layout, depth, *this);
  std::vector<std::int32_t> fronts;
  for (const Subtree& subtree : subtrees) {
    fronts.resize(subtree.last - subtree.first + 1);
    std::iota(fronts.begin(), fronts.end(), subtree.first);
    const auto inner = [&](std::int32_t f) { return f != subtree.last; };
    thread_size = std::max(thread_size, stacks.lay_out(fronts, inner));
  }
  fronts.clear();
  for (const TopFront& t : top) {
    fronts.push_back(t.front);
    in_common[t.front] = true;
  }
  common_size = stacks.lay_out(fronts, [&](std::int32_t f) { return subtree_of[f] < 0; });
  for (const Subtree& subtree : subtrees) {
    in_common[subtree.last] = true;
    contribution[subtree.last] = common_size;
    common_size += (layout.contribution_size(subtree.last) + 7) / 8 * 8;
  }
  std::stable_sort(subtrees.begin(), subtrees.end(),
                   [&](const Subtree& a, const Subtree& b) { return cost[a.last] > cost[b.last]; });
}

}  // namespace masat
