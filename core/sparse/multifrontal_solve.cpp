#include <algorithm>

#include "sparse/block_size.hpp"
#include "sparse/multifrontal.hpp"

namespace masat {

template <int kSize>
void Multifrontal::solve_blocks(double* x) const {
  const AssemblyTree& tree = layout_.tree();
  // The pivots' part and that of the rows, each of whole vectors.
  double* const pivots = gathered_.data();
  const auto take_pivots = [&](const Front& front, const double* own) {
    std::fill(std::copy(own, own + front.pivots, pivots), pivots + front.ld11, 0.0);
  };

  for (std::int32_t f = 0; f < layout_.fronts(); ++f) {
    const Front front = layout_.front(f, factor_.data());
    double* const own = x + layout_.first(f);
    double* const rows = pivots + front.ld11;
    take_pivots(front, own);
    kernels_.forward(front, reciprocal_.data() + layout_.first(f), pivots, rows);
    std::copy(pivots, pivots + front.pivots, own);
    const double* from = rows;
    for (const std::int32_t row : tree.rows(f)) {
      double* const to = x + std::int64_t{row} * kSize;
      for (int i = 0; i < kSize; ++i) to[i] -= *from++;
    }
  }

  for (std::int32_t f = layout_.fronts() - 1; f >= 0; --f) {
    const Front front = layout_.front(f, factor_.data());
    double* const own = x + layout_.first(f);
    double* const rows = pivots + front.ld11;
    take_pivots(front, own);
    double* to = rows;
    for (const std::int32_t row : tree.rows(f)) {
      to = std::copy_n(x + std::int64_t{row} * kSize, kSize, to);
    }
    std::fill(to, rows + front.ld21, 0.0);
    kernels_.backward(front, reciprocal_.data() + layout_.first(f), pivots, rows);
    std::copy(pivots, pivots + front.pivots, own);
  }
}

void Multifrontal::solve(std::span<double> x) {
  with_block_size(layout_.block_size(), [&]<int kSize>() { solve_blocks<kSize>(x.data()); });
}

}  // namespace masat
