#include "online/partial_tree.hpp"

#include <algorithm>

#include "sparse/front_cost.hpp"

namespace masat {
namespace {

// The front of the newest node is computed at each step, so it stays small: at most so many pivots.
constexpr std::int32_t kNewestPivots = 4;

}  // namespace

void PartialTree::build(const MinimumDegree& order, std::int32_t variables, int block_size) {
  order_ = &order;
  merge(variables, block_size);
  const auto groups = order.groups();
  const auto n = static_cast<std::int32_t>(groups.size());

  front_of_group_.assign(n, -1);
  std::int32_t fronts = 0;
  for (std::int32_t g = 0; g < n; ++g) {
    if (merged_into_[g] == g) front_of_group_[g] = fronts++;
  }
  for (std::int32_t g = 0; g < n; ++g) front_of_group_[g] = front_of_group_[merged_into_[g]];

  parent_.assign(fronts, -1);
  pivot_begin_.assign(fronts + 1, 0);
  row_begin_.assign(1, 0);
  row_.clear();
  for (std::int32_t g = 0; g < n; ++g) {
    pivot_begin_[front_of_group_[g] + 1] += groups[g].pivots;
    if (merged_into_[g] != g) continue;
    if (groups[g].parent >= 0) parent_[front_of_group_[g]] = front_of_group_[groups[g].parent];
    const auto rows = order.rows(groups[g]);
    row_.insert(row_.end(), rows.begin(), rows.end());
    row_begin_.push_back(static_cast<std::int32_t>(row_.size()));
  }
  for (std::int32_t f = 0; f < fronts; ++f) pivot_begin_[f + 1] += pivot_begin_[f];
  pivot_.resize(variables);
  last_front_.assign(pivot_begin_.begin(), pivot_begin_.end() - 1);  // where the next pivot goes
  for (std::int32_t g = 0; g < n; ++g) {
    const auto own = order.eliminated().subspan(groups[g].first, groups[g].pivots);
    std::int32_t& next = last_front_[front_of_group_[g]];
    std::copy(own.begin(), own.end(), pivot_.begin() + next);
    next += groups[g].pivots;
  }
  position_.resize(variables);
  for (std::int32_t k = 0; k < variables; ++k) position_[pivot_[k]] = k;
  for (std::int32_t f = 0; f < fronts; ++f) {
    std::sort(row_.begin() + row_begin_[f], row_.begin() + row_begin_[f + 1],
              [&](std::int32_t a, std::int32_t b) { return position_[a] < position_[b]; });
  }
}

// Greedy, from the leaves up, as in the batch factorization.
void PartialTree::merge(std::int32_t variables, int block_size) {
  const auto groups = order_->groups();
  const auto n = static_cast<std::int32_t>(groups.size());
  merged_into_.resize(n);
  pivots_.resize(n);
  first_child_.assign(n, -1);
  next_child_.assign(n, -1);
  for (std::int32_t g = n - 1; g >= 0; --g) {
    if (groups[g].parent < 0) continue;
    next_child_[g] = first_child_[groups[g].parent];
    first_child_[groups[g].parent] = g;
  }
  for (std::int32_t p = 0; p < n; ++p) {
    const auto own = order_->eliminated().subspan(groups[p].first, groups[p].pivots);
    const bool newest = std::find(own.begin(), own.end(), variables - 1) != own.end();
    merged_into_[p] = p;
    pivots_[p] = groups[p].pivots;
    children_.clear();
    for (std::int32_t c = first_child_[p]; c >= 0; c = next_child_[c]) children_.push_back(c);
    std::stable_sort(children_.begin(), children_.end(), [&](std::int32_t a, std::int32_t b) {
      return groups[a].rows > groups[b].rows;
    });
    for (const std::int32_t c : children_) {
      const Supernode parent{pivots_[p], groups[p].rows}, child{pivots_[c], groups[c].rows};
      const Supernode merged{parent.pivots + child.pivots, parent.rows};
      if (newest && merged.pivots > kNewestPivots) continue;
      if (front_cost(merged, block_size) <=
          front_cost(parent, block_size) + front_cost(child, block_size)) {
        pivots_[p] = merged.pivots;
        merged_into_[c] = p;
      }
    }
  }
  for (std::int32_t g = n - 1; g >= 0; --g) merged_into_[g] = merged_into_[merged_into_[g]];
}

}  // namespace masat
