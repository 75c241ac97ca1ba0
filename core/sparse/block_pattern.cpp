#include "sparse/block_pattern.hpp"

namespace masat {

BlockGraph::BlockGraph(const BlockPattern& pattern) : start_(pattern.columns() + 1, 0) {
  const std::int32_t n = pattern.columns();
  const auto for_each = [&](auto visit) {
    for (std::int32_t c = 0; c < n; ++c) {
      for (std::int64_t k = pattern.start[c] + 1; k < pattern.start[c + 1]; ++k) {
        visit(c, pattern.row[k], static_cast<std::int32_t>(k));
      }
    }
  };
  for_each([&](std::int32_t c, std::int32_t r, std::int32_t) { ++start_[c], ++start_[r]; });
  std::int64_t sum = 0;
  for (std::int64_t& s : start_)
    sum += s, s = sum;  // ends, which the loop below moves to the starts
  neighbor_.resize(sum);
  for_each([&](std::int32_t c, std::int32_t r, std::int32_t k) {
    neighbor_[--start_[c]] = {r, k};
    neighbor_[--start_[r]] = {c, k};
  });
}

}  // namespace masat
