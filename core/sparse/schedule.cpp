#include "sparse/schedule.hpp"

#include <algorithm>
#include <numeric>
#include <span>

namespace masat {
namespace {

// A front of at least this many operations is worth sharing: its work outweighs the time for which
// the threads wait for each other.
constexpr double kShared = 2e6;

// Estimated floating-point operations of a front, with its assembly.
double front_cost(const FrontLayout& layout, std::int32_t f) {
  const double pivots = layout.shape(f).pivots, rows = layout.shape(f).rows;
  return pivots * (pivots * pivots / 3 + rows * (pivots + rows)) + 4 * rows * rows + 4000;
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

TreeCut::TreeCut(const AssemblyTree& tree, const std::vector<double>& cost, double limit) {
  std::vector<double> whole = cost;  // of a front and all those below it
  for (std::int32_t f = 0; f < tree.fronts(); ++f) {
    if (tree.parent[f] >= 0) whole[tree.parent[f]] += whole[f];
  }
  std::vector<bool> inside(tree.fronts(), false);
  for (std::int32_t f = tree.fronts() - 1; f >= 0; --f) {
    if (tree.parent[f] >= 0 && inside[tree.parent[f]]) {
      inside[f] = true;
      subtrees.back().first = f;  // the descendants of a front come right before it
    } else if (whole[f] <= limit) {
      inside[f] = true;
      subtrees.push_back({f, f});
      costs.push_back(whole[f]);
    } else {
      top.push_back(f);
    }
  }
  std::reverse(subtrees.begin(), subtrees.end());
  std::reverse(costs.begin(), costs.end());
  std::reverse(top.begin(), top.end());
}

Schedule::Schedule(const FrontLayout& layout, int threads) {
  const std::int32_t n = layout.fronts();
  std::vector<double> cost(n);
  for (std::int32_t f = 0; f < n; ++f) cost[f] = front_cost(layout, f);
  const double total = std::accumulate(cost.begin(), cost.end(), 0.0);
  // A subtree is the largest that still lets the threads be balanced.
  const TreeCut cut(layout.tree(), cost, threads > 1 ? total / (8 * threads) : 0);
  for (const std::int32_t f : cut.top) top.push_back({f, threads > 1 && cost[f] > kShared});

  std::vector<std::int32_t> depth(n, 0);
  for (std::int32_t f = n - 1; f >= 0; --f) {
    const std::int32_t parent = layout.tree().parent[f];
    if (parent >= 0) depth[f] = depth[parent] + 1;
  }
  contribution.assign(n, 0);
  in_common.assign(n, false);
  Stacks stacks(layout, depth, *this);
  std::vector<std::int32_t> fronts;
  for (const Subtree& subtree : cut.subtrees) {
    fronts.resize(subtree.last - subtree.first + 1);
    std::iota(fronts.begin(), fronts.end(), subtree.first);
    const auto inner = [&](std::int32_t f) { return f != subtree.last; };
    thread_size = std::max(thread_size, stacks.lay_out(fronts, inner));
  }
  for (const std::int32_t f : cut.top) in_common[f] = true;
  common_size = stacks.lay_out(cut.top, [&](std::int32_t f) { return in_common[f]; });
  for (const Subtree& subtree : cut.subtrees) {
    in_common[subtree.last] = true;
    contribution[subtree.last] = common_size;
    common_size += (layout.contribution_size(subtree.last) + 7) / 8 * 8;
  }
  std::vector<std::size_t> order(cut.subtrees.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return cut.costs[a] > cut.costs[b]; });
  for (const std::size_t k : order) subtrees.push_back(cut.subtrees[k]);
}

}  // namespace masat
