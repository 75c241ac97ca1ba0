// The fronts that eliminate a part of the nodes, and their tree.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "online/minimum_degree.hpp"

namespace masat {

class PartialTree {
 public:
  // Merges the groups of an order into fronts where that saves time. The last variable, which the
  // next step will touch, is merged only with few others.
  void build(const MinimumDegree& order, std::int32_t variables, int block_size);

  std::int32_t fronts() const { return static_cast<std::int32_t>(parent_.size()); }
  // Variables that a front eliminates, in this order. A front's parent comes after it, or is -1.
  std::span<const std::int32_t> pivots(std::int32_t f) const {
    return {pivot_.data() + pivot_begin_[f], pivot_.data() + pivot_begin_[f + 1]};
  }
  // Variables below the pivots, in the order in which they are eliminated.
  std::span<const std::int32_t> rows(std::int32_t f) const {
    return {row_.data() + row_begin_[f], row_.data() + row_begin_[f + 1]};
  }
  std::int32_t parent(std::int32_t f) const { return parent_[f]; }
  // The front that is the parent of an element.
  std::int32_t parent_of_element(std::int32_t e) const {
    return front_of_group_[order_->parent_of_element(e)];
  }

 private:
  void merge(std::int32_t variables, int block_size);

  const MinimumDegree* order_ = nullptr;
  std::vector<std::int32_t> merged_into_, pivots_, first_child_, next_child_, children_;
  std::vector<std::int32_t> front_of_group_, parent_, pivot_begin_, pivot_, row_begin_, row_;
  std::vector<std::int32_t> position_, last_front_;
};

}  // namespace masat
