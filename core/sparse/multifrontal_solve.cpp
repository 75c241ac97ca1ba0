#include <algorithm>
#include <type_traits>

#include "sparse/block_size.hpp"
#include "sparse/multifrontal.hpp"

namespace masat {

// A row of blocks has `block` scalars of x. For one right-hand side, `width` and `block` are
// compile-time constants.
template <class Width, class Block>
void Multifrontal::solve_blocks(std::span<double> x, Width width, Block block, bool reduce,
                                bool substitute) const {
  const AssemblyTree& tree = layout_.tree();
  const auto group = static_cast<std::int64_t>(reciprocal_.size()) * width;
  const auto forward = width == 1 ? kernels_.forward : kernels_.forward_wide;
  const auto backward = width == 1 ? kernels_.backward : kernels_.backward_wide;
  // The values at the pivots of a front, followed by those at its rows, both padded to whole
  // vectors.
  double* const pivots = gathered_.data();
  const auto take_pivots = [&](const Front& front, const double* own) {
    std::fill(std::copy(own, own + front.pivots * width, pivots), pivots + front.ld11 * width, 0.0);
  };

  // With one right-hand side, solving is short beside the factorization.
  InterruptPoll interrupt;
  const double columns = double(x.size()) / std::max<double>(reciprocal_.size(), 1);
  const auto poll = [&](const Front& front) {
    if (width > 1) interrupt.add(columns * front.pivots * (front.pivots + front.rows));
  };

  for (std::int32_t f = 0; reduce && f < layout_.fronts(); ++f) {
    if (!tree.is_eliminated(f)) continue;
    const Front front = layout_.front(f, factor_.data());
    poll(front);
    double* const rows = pivots + front.ld11 * width;
    for (auto base = x.begin(); base != x.end(); base += group) {
      double* const own = &base[layout_.first(f) * width];
      take_pivots(front, own);
      forward(front, reciprocal_.data() + layout_.first(f), pivots, rows);
      std::copy(pivots, pivots + front.pivots * width, own);
      const double* from = rows;
      for (const std::int32_t row : tree.rows(f)) {
        double* const to = &base[std::int64_t{row} * block];
        for (int i = 0; i < block; ++i) to[i] -= *from++;
      }
    }
  }

  for (std::int32_t f = layout_.fronts() - 1; substitute && f >= 0; --f) {
    if (!tree.is_eliminated(f)) continue;
    const Front front = layout_.front(f, factor_.data());
    poll(front);
    double* const rows = pivots + front.ld11 * width;
    for (auto base = x.begin(); base != x.end(); base += group) {
      double* const own = &base[layout_.first(f) * width];
      take_pivots(front, own);
      double* to = rows;
      for (const std::int32_t row : tree.rows(f)) {
        to = std::copy_n(&base[std::int64_t{row} * block], block, to);
      }
      std::fill(to, rows + front.ld21 * width, 0.0);
      backward(front, reciprocal_.data() + layout_.first(f), pivots, rows);
      std::copy(pivots, pivots + front.pivots * width, own);
    }
  }
}

void Multifrontal::solve_one(std::span<double> x, bool reduce, bool substitute) const {
  with_block_size(layout_.block_size(), [&]<int kSize>() {
    solve_blocks(x, std::integral_constant<int, 1>{}, std::integral_constant<int, kSize>{}, reduce,
                 substitute);
  });
}

void Multifrontal::solve(std::span<double> x, int width) const {
  if (width == 1) return solve_one(x, true, true);
  solve_blocks(x, width, layout_.block_size() * width, true, true);
}

}  // namespace masat
