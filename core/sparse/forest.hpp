// Permutations and forests given by their parents.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace masat {

std::vector<std::int32_t> invert(std::span<const std::int32_t> permutation);

// The nodes of a forest, those of each subtree side by side and its root last. Parents have greater
// numbers than their children; roots have parent -1.
std::vector<std::int32_t> postorder(std::span<const std::int32_t> parent);

// The children of each node, ascending.
class Children {
 public:
  explicit Children(std::span<const std::int32_t> parent);
  std::span<const std::int32_t> of(std::int32_t node) const {
    return {child_.data() + start_[node], child_.data() + start_[node + 1]};
  }

 private:
  std::vector<std::int32_t> start_, child_;
};

}  // namespace masat
