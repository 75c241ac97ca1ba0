#include "sparse/forest.hpp"

#include <numeric>

namespace masat {

std::vector<std::int32_t> invert(std::span<const std::int32_t> order) {
  std::vector<std::int32_t> index(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) index[order[k]] = static_cast<std::int32_t>(k);
  return index;
}

std::vector<std::int32_t> postorder(std::span<const std::int32_t> parent) {
  const auto n = static_cast<std::int32_t>(parent.size());
  std::vector<std::int32_t> size(n, 1), end(n), order(n);
  for (std::int32_t k = 0; k < n; ++k) {
    if (parent[k] >= 0) size[parent[k]] += size[k];
  }
  // Parents come after their children. From the last node on, each takes the last position that is
  // free in the range of its subtree.
  std::int32_t free = n;
  for (std::int32_t k = n - 1; k >= 0; --k) {
    std::int32_t& last = parent[k] < 0 ? free : end[parent[k]];
    order[last - 1] = k;
    end[k] = last - 1;
    last -= size[k];
  }
  return order;
}

Children::Children(std::span<const std::int32_t> parent) : start_(parent.size() + 1, 0) {
  const auto n = static_cast<std::int32_t>(parent.size());
  for (const std::int32_t p : parent) {
    if (p >= 0) ++start_[p];
  }
  std::partial_sum(start_.begin(), start_.end(), start_.begin());
  child_.resize(start_.back());
  for (std::int32_t k = n - 1; k >= 0; --k) {
    if (parent[k] >= 0) child_[--start_[parent[k]]] = k;
  }
}

}  // namespace masat
