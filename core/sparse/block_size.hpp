#pragma once

#include <stdexcept>
#include <utility>

namespace masat {

constexpr int kLargestBlock = 10;

// Calls f with the number of rows of a block, 1 to 10, as a compile-time constant.
template <class F>
void with_block_size(int size, F f) {
  if (size < 1 || size > kLargestBlock) throw std::invalid_argument("blocks have 1 to 10 rows");
  [&]<int... kSmaller>(std::integer_sequence<int, kSmaller...>) {
    ((size == kSmaller + 1 ? f.template operator()<kSmaller + 1>() : void()), ...);
  }(std::make_integer_sequence<int, kLargestBlock>());
}

}  // namespace masat
