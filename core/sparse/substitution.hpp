// Forward and backward substitution with a multifrontal factor.
#pragma once

#include <atomic>
#include <cstdint>
#include <exception>
#include <vector>

#include "interrupt.hpp"
#include "sparse/aligned_buffer.hpp"
#include "sparse/front_layout.hpp"
#include "sparse/kernels.hpp"
#include "sparse/multifrontal.hpp"
#include "sparse/schedule.hpp"
#include "sparse/worker_pool.hpp"

namespace masat {

// Right-hand sides lie side by side in groups, in the elimination order. Below those of the nodes,
// a group has rows for what subtrees subtract from the nodes above them: so subtrees do not disturb
// each other, and sums have the same order for any number of threads.
class Substitution {
 public:
  // The layout and the pool must outlive this object.
  Substitution(const FrontLayout& layout, const Kernels& kernels, WorkerPool& pool);

  // Makes room for groups of `width` right-hand sides, either one or as many as the kernels'
  // `width`. The values are undefined if there was less room before, otherwise those of before.
  void reserve(int width, int groups);
  // The rows of a group: `width` values for each unknown.
  double* group(int index) { return values_.data() + index * group_size(); }

  // Overwrites the right-hand sides with the solutions. Throws what check_interrupt() throws.
  void solve(const Multifrontal& factor) { run(factor, true, true); }
  // The two halves of it. Between them, the values of the boundary are those of the reduced
  // right-hand side, for which its solution has to be put in.
  void reduce(const Multifrontal& factor) { run(factor, true, false); }
  void substitute(const Multifrontal& factor) { run(factor, false, true); }

 private:
  std::int64_t group_size() const { return rows_ * layout_.block_size() * width_; }
  void run(const Multifrontal& factor, bool reduce, bool substitute);
  template <class Width, class Block>
  void reduce_groups(const Multifrontal& factor, Width width, Block block);
  template <class Width, class Block>
  void substitute_groups(const Multifrontal& factor, Width width, Block block);
  template <class Width, class Block>
  void forward(const Multifrontal& factor, std::int32_t f, int rank, Width width, Block block);
  template <class Width, class Block>
  void backward(const Multifrontal& factor, std::int32_t f, int rank, Width width, Block block);
  bool goes_on(const Front& front, int rank) noexcept;

  const FrontLayout& layout_;
  const Kernels& kernels_;
  WorkerPool& pool_;
  TreeCut cut_;
  std::vector<std::int32_t> target_;  // of each row of the fronts: where its part is subtracted
  std::vector<std::int64_t> outer_;   // the first row of each subtree's parts for the nodes above
  std::int64_t rows_;                 // of blocks in a group
  int width_ = 1, groups_ = 0;
  AlignedBuffer values_;
  std::int64_t capacity_ = 0;         // of the values
  std::vector<AlignedBuffer> front_;  // of each thread: the values at a front's pivots and its rows
  InterruptPoll poll_;
  std::atomic<bool> stopped_{false};
  std::exception_ptr interruption_;  // thrown in the first thread, and not yet by run
};

}  // namespace masat
