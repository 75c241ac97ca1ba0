#include "sparse/substitution.hpp"

#include <algorithm>
#include <numeric>
#include <type_traits>
#include <utility>

#include "sparse/block_size.hpp"

namespace masat {
namespace {

// Entries of a factor, with some for each front, below which a subtree is too small for a task:
// some ten microseconds of work.
constexpr double kLeastPerTask = 3e4, kPerFront = 50;
constexpr double kSubtrees = 32;  // about as many, so that some threads are balanced

TreeCut cut_tree(const FrontLayout& layout) {
  std::vector<double> cost(layout.fronts());
  for (std::int32_t f = 0; f < layout.fronts(); ++f) {
    const double pivots = layout.shape(f).pivots, rows = layout.shape(f).rows;
    cost[f] = pivots * (pivots / 2 + rows) + kPerFront;
  }
  const double limit = std::accumulate(cost.begin(), cost.end(), 0.0) / kSubtrees;
  return {layout.tree(), cost, limit < kLeastPerTask ? 0 : limit};
}

}  // namespace

Substitution::Substitution(const FrontLayout& layout, const Kernels& kernels, WorkerPool& pool)
    : layout_(layout),
      kernels_(kernels),
      pool_(pool),
      cut_(cut_tree(layout)),
      target_(layout.tree().row),
      rows_(static_cast<std::int64_t>(layout.tree().order.size())) {
  const AssemblyTree& tree = layout.tree();
  std::vector<std::int32_t> row_of(tree.order.size());  // of each node above a subtree
  for (const Subtree& subtree : cut_.subtrees) {
    const std::int32_t end = tree.first[subtree.last + 1];
    outer_.push_back(rows_);
    for (const std::int32_t row : tree.rows(subtree.last)) {
      row_of[row] = static_cast<std::int32_t>(rows_++);
    }
    for (auto k = tree.row_start[subtree.first]; k < tree.row_start[subtree.last + 1]; ++k) {
      if (target_[k] >= end) target_[k] = row_of[target_[k]];
    }
  }
}

void Substitution::reserve(int width, int groups) {
  if (width != width_ || front_.empty()) {
    std::int64_t widest = 0;
    for (std::int32_t f = 0; f < layout_.fronts(); ++f) {
      widest = std::max(widest, layout_.shape(f).ld11 + layout_.shape(f).ld21);
    }
    std::vector<AlignedBuffer> front;
    for (int t = 0; t < pool_.threads(); ++t) front.emplace_back(widest * width);
    front_ = std::move(front);
  }
  width_ = width;
  groups_ = groups;
  if (groups * group_size() > capacity_) {
    values_ = AlignedBuffer(groups * group_size());
    capacity_ = groups * group_size();
  }
}

// A row of blocks has `block` scalars of a group. For one right-hand side, `width` and `block` are
// compile-time constants, and no look at the signals is needed: it is short beside the
// factorization.
void Substitution::run(const Multifrontal& factor, bool reduce, bool substitute) {
  const WorkerPool::Session session(pool_);
  stopped_.store(false, std::memory_order_relaxed);
  const auto run_groups = [&](auto width, auto block) {
    if (reduce) reduce_groups(factor, width, block);
    if (substitute) substitute_groups(factor, width, block);
  };
  if (width_ > 1) {
    run_groups(width_, layout_.block_size() * width_);
  } else {
    with_block_size(layout_.block_size(), [&]<int kSize>() {
      run_groups(std::integral_constant<int, 1>{}, std::integral_constant<int, kSize>{});
    });
  }
  if (interruption_) std::rethrow_exception(std::exchange(interruption_, nullptr));
}

template <class Width, class Block>
void Substitution::reduce_groups(const Multifrontal& factor, Width width, Block block) {
  const auto subtrees = static_cast<std::int32_t>(cut_.subtrees.size());
  const AssemblyTree& tree = layout_.tree();
  const std::int64_t nodes = static_cast<std::int64_t>(tree.order.size()) * block;
  for (int g = 0; g < groups_; ++g) std::fill(group(g) + nodes, group(g + 1), 0.0);
  pool_.for_each(subtrees, [&](std::int32_t s, int rank) {
    const Subtree& subtree = cut_.subtrees[s];
    for (std::int32_t f = subtree.first; f <= subtree.last; ++f) {
      forward(factor, f, rank, width, block);
    }
  });
  for (std::int32_t s = 0; s < subtrees; ++s) {
    for (int g = 0; g < groups_; ++g) {
      const double* from = group(g) + outer_[s] * block;
      for (const std::int32_t row : tree.rows(cut_.subtrees[s].last)) {
        double* const to = group(g) + std::int64_t{row} * block;
        for (int i = 0; i < block; ++i) to[i] += *from++;
      }
    }
  }
  for (const std::int32_t f : cut_.top) forward(factor, f, 0, width, block);
}

template <class Width, class Block>
void Substitution::substitute_groups(const Multifrontal& factor, Width width, Block block) {
  for (auto f = cut_.top.rbegin(); f != cut_.top.rend(); ++f) backward(factor, *f, 0, width, block);
  pool_.for_each(static_cast<std::int32_t>(cut_.subtrees.size()), [&](std::int32_t s, int rank) {
    const Subtree& subtree = cut_.subtrees[s];
    for (std::int32_t f = subtree.last; f >= subtree.first; --f) {
      backward(factor, f, rank, width, block);
    }
  });
}

template <class Width, class Block>
void Substitution::forward(const Multifrontal& factor, std::int32_t f, int rank, Width width,
                           Block block) {
  if (!layout_.tree().is_eliminated(f)) return;
  const Front front = factor.front(f);
  if (width > 1 && !goes_on(front, rank)) return;
  const auto kernel = width == 1 ? kernels_.forward : kernels_.forward_wide;
  const std::int32_t* const begin = target_.data() + layout_.tree().row_start[f];
  const std::int32_t* const end = target_.data() + layout_.tree().row_start[f + 1];
  // The values at the pivots, padded to whole vectors, and those at the rows.
  double* const pivots = front_[rank].data();
  double* const rows = pivots + front.ld11 * width;
  for (int g = 0; g < groups_; ++g) {
    double* const x = group(g);
    double* const own = x + layout_.first(f) * width;
    std::fill(std::copy(own, own + front.pivots * width, pivots), rows, 0.0);
    kernel(front, factor.reciprocal(f), pivots, rows);
    std::copy(pivots, pivots + front.pivots * width, own);
    const double* from = rows;
    for (const std::int32_t* row = begin; row != end; ++row) {
      double* const to = x + std::int64_t{*row} * block;
      for (int i = 0; i < block; ++i) to[i] -= *from++;
    }
  }
}

template <class Width, class Block>
void Substitution::backward(const Multifrontal& factor, std::int32_t f, int rank, Width width,
                            Block block) {
  if (!layout_.tree().is_eliminated(f)) return;
  const Front front = factor.front(f);
  if (width > 1 && !goes_on(front, rank)) return;
  const auto kernel = width == 1 ? kernels_.backward : kernels_.backward_wide;
  double* const pivots = front_[rank].data();
  double* const rows = pivots + front.ld11 * width;
  for (int g = 0; g < groups_; ++g) {
    double* const x = group(g);
    double* const own = x + layout_.first(f) * width;
    std::fill(std::copy(own, own + front.pivots * width, pivots), rows, 0.0);
    double* to = rows;
    for (const std::int32_t row : layout_.tree().rows(f)) {
      to = std::copy_n(x + std::int64_t{row} * block, block, to);
    }
    std::fill(to, rows + front.ld21 * width, 0.0);
    kernel(front, factor.reciprocal(f), pivots, rows);
    std::copy(pivots, pivots + front.pivots * width, own);
  }
}

// Notices Ctrl-C in the thread that called solve.
bool Substitution::goes_on(const Front& front, int rank) noexcept {
  if (rank == 0) {
    try {
      poll_.add(double(groups_) * width_ * front.pivots * (front.pivots + front.rows));
    } catch (...) {
      interruption_ = std::current_exception();
      stopped_.store(true, std::memory_order_relaxed);
    }
  }
  return !stopped_.load(std::memory_order_relaxed);
}

}  // namespace masat
