// Numeric multifrontal Cholesky factorization over a fixed layout.
#pragma once

#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "sparse/aligned_buffer.hpp"
#include "sparse/front_layout.hpp"
#include "sparse/kernels.hpp"
#include "sparse/schedule.hpp"
#include "sparse/worker_pool.hpp"

namespace masat {

class Multifrontal {
 public:
  // The layout must outlive this.
  Multifrontal(const FrontLayout& layout, const Kernels& kernels, int threads);

  // Returns -1, or the first place in the elimination order whose pivot broke. The factor is the
  // same for any number of threads.
  std::int32_t factorize(std::span<const double> values, std::span<const double> damping);

  // The same, but a node whose pivot breaks is held: `held`, or more where that is not enough,
  // takes the place of its damping, and its front is computed anew. Marks these nodes in `broken`.
  std::int32_t factorize(std::span<const double> values, std::span<double> damping,
                         std::span<const double> held, std::vector<char>& broken);

  // Overwrites right-hand sides, in the elimination order, with the solutions. A row has `width`
  // of them side by side, one or as many as the kernels' `width`; more follow in further groups.
  void solve(std::span<double> x, int width);

  // A front of the factor; its contribution block is gone.
  Front front(std::int32_t f) const { return layout_.front(f, factor_.data()); }

 private:
  double* contribution(std::int32_t f, int rank) const;
  void assemble_pivots(const Front& front, std::int32_t f, int rank, std::int32_t begin,
                       std::int32_t end);
  void add_children(const Front& front, std::int32_t f, int rank, std::int32_t begin,
                    std::int32_t end);
  template <class Threads>
  void process(std::int32_t f, int rank, Threads&& threads);
  template <class Threads>
  std::int32_t eliminate(const Front& front, std::int32_t f, Threads&& threads);
  bool matters(std::int32_t f) const;
  template <class Width, class Block>
  void solve_blocks(std::span<double> x, Width width, Block block) const;
  void report_broken(std::int64_t column);
  bool hold(std::int64_t column) const;

  const FrontLayout& layout_;
  const Kernels& kernels_;
  WorkerPool pool_;
  Schedule schedule_;
  AlignedBuffer factor_, common_, gathered_;
  std::vector<AlignedBuffer> own_;          // of each thread
  std::vector<double> reciprocal_, floor_;  // of each pivot; at or below its floor it is broken
  std::span<const double> values_, damping_;
  struct Holding {
    std::span<double> damping;
    std::span<const double> held;
    std::vector<char>& broken;
  };
  const Holding* holding_ = nullptr;
  std::atomic<std::int64_t> broken_{0};  // the first broken column so far
};

}  // namespace masat
