// Which thread computes which fronts, and where their contribution blocks are stored.
#pragma once

#include <cstdint>
#include <vector>

#include "sparse/front_layout.hpp"

namespace masat {

struct Subtree {
  std::int32_t first, last;  // fronts, the root last
};

// Subtrees that threads can process at the same time, and the other fronts, both in postorder.
struct TreeCut {
  // A subtree is the largest whose cost is at most `limit`; `cost` is that of each front.
  TreeCut(const AssemblyTree& tree, const std::vector<double>& cost, double limit);

  std::vector<Subtree> subtrees;
  std::vector<double> costs;  // of the subtrees
  std::vector<std::int32_t> top;
};

struct Schedule {
  struct TopFront {
    std::int32_t front;
    bool shared;  // large enough for all threads to work on it
  };

  // The schedule of a single thread has no subtrees.
  Schedule(const FrontLayout& layout, int threads);

  std::vector<Subtree> subtrees;  // one thread each, the most expensive first
  std::vector<TopFront> top;      // the other fronts in postorder, one by one after the subtrees

  // Offsets of the contribution blocks: inside a subtree in the workspace of its thread, otherwise
  // in the common one.
  std::vector<std::int64_t> contribution;
  std::int64_t common_size = 0, thread_size = 0;
  std::vector<bool> in_common;
};

}  // namespace masat
