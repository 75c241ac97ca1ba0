#pragma once

namespace masat {

// Calls f with the rows of a block, 1 to 6, as a compile-time constant.
template <class F>
auto with_block_size(int size, F f) {
  switch (size) {
    case 1:
      return f.template operator()<1>();
    case 2:
      return f.template operator()<2>();
    case 3:
      return f.template operator()<3>();
    case 4:
      return f.template operator()<4>();
    case 5:
      return f.template operator()<5>();
    default:
      return f.template operator()<6>();
  }
}

}  // namespace masat
