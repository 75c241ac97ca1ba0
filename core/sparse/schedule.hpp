// Who computes which fronts, and where their contribution blocks live.
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
    bool shared;  // worth more than one thread
  };

  // A single thread's has no subtrees.
  Schedule(const FrontLayout& layout, int threads);

  std::vector<Subtree> subtrees;  // one thread each, the costly first
  std::vector<TopFront> top;      // the other fronts, one by one after the subtrees; a postorder

  // Offsets of the contribution blocks: inside a subtree in the workspace of its thread, else in
  // the common one.
  std::vector<std::int64_t> contribution;
  std::int64_t common_size = 0, thread_size = 0;
  std::vector<bool> in_common;
};

}  // namespace masat
