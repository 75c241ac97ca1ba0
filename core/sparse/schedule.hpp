// Which thread computes which fronts, and where their contribution blocks are stored.
#pragma once

#include <cstdint>
#include <vector>

#include "sparse/front_layout.hpp"

namespace masat {

struct Schedule {
  struct Subtree {
    std::int32_t first, last;  // fronts, the root last
  };

  struct TopFront {
    std::int32_t front;
    bool shared;  // large enough for all threads to work on it
  };

  // The schedule of a single thread has no subtrees.
  Schedule(const FrontLayout& layout, int asked_threads);

  int threads;  // that can find work at the same time, at most as many as asked for

  std::vector<Subtree> subtrees;  // one thread each, the most expensive first
  std::vector<TopFront> top;      // the other fronts in postorder, one by one after the subtrees

  // Offsets of the contribution blocks: inside a subtree in the workspace of its thread, otherwise
  // in the common one.
  std::vector<std::int64_t> contribution;
  std::int64_t common_size = 0, thread_size = 0;
  std::vector<bool> in_common;
};

}  // namespace masat
