// Numeric multifrontal Cholesky factorization over a fixed layout.
#pragma once

#include <atomic>
#include <cstdint>
#include <exception>
#include <span>
#include <stdexcept>
#include <vector>

#include "interrupt.hpp"
#include "sparse/aligned_buffer.hpp"
#include "sparse/front_layout.hpp"
#include "sparse/kernels.hpp"
#include "sparse/schedule.hpp"
#include "sparse/worker_pool.hpp"

namespace masat {

// A contribution block that was computed elsewhere: the lower triangle of a symmetric matrix over
// `nodes`, packed column by column.
struct Element {
  std::span<const std::int32_t> nodes;
  const double* block;
};

// Thrown where the values at a boundary are asked for too late.
struct OverwrittenByOther : std::logic_error {
  OverwrittenByOther()
      : logic_error("another part has been factorized since: call factorize() again") {}
};

class Multifrontal {
 public:
  // The layout and the pool must outlive this object.
  Multifrontal(const FrontLayout& layout, const Kernels& kernels, WorkerPool& pool);

  // Returns -1, or the first index in the elimination order whose pivot failed. The factor is the
  // same for any number of threads. Throws what check_interrupt() throws. `elements` are the
  // contribution blocks that the elements of the layout stand for.
  [[nodiscard]] std::int32_t factorize(std::span<const double> values,
                                       std::span<const double> damping,
                                       std::span<const Element> elements = {});

  // The same, but a node whose pivot fails is fixed: `fixing`, or more where that is not enough,
  // replaces its damping, and its front is computed again. Returns a flag for each node.
  std::vector<char> fix_failing(std::span<const double> values, std::span<double> damping,
                                std::span<const double> fixing);

  // The smallest ratio of a pivot to its diagonal entry before the elimination, of the last
  // factorization, which must have succeeded; 1 without pivots.
  double pivot_ratio() const;

  // Frees the workspace of parts that this thread has factorized.
  static void free_workspace();

  WorkerPool& pool() const { return pool_; }

  // A front of the factor, without its contribution block, which is not kept, and 1 / sqrt(pivot)
  // for each of its pivots.
  Front front(std::int32_t f) const { return layout_.front(f, values(f)); }
  // The front of the boundary, which holds what the last factorization leaves there. Throws
  // OverwrittenByOther if this thread has factorized another part since, or another thread this
  // one.
  Front boundary() const;
  const double* reciprocal(std::int32_t f) const { return reciprocal_.data() + layout_.first(f); }

 private:
  struct Fixing {
    std::span<double> damping;
    std::span<const double> fixing;
    std::vector<char>& fixed;
  };

  double* values(std::int32_t f) const { return factor_.data() + layout_.factor_start(f); }
  double* contribution(std::int32_t f, int rank) const;
  void assemble_pivots(const Front& front, std::int32_t f, int rank, std::int32_t begin,
                       std::int32_t end);
  void add_children(const Front& front, std::int32_t f, int rank, std::int32_t begin,
                    std::int32_t end);
  template <class Threads>
  void process(std::int32_t f, int rank, Threads&& threads);
  template <class Threads>
  std::int32_t eliminate(const Front& front, std::int32_t f, int rank, Threads&& threads);
  bool matters(std::int32_t f) const;
  void copy_element(double* to, std::int32_t f, const Element& element) const;
  void report_failed(std::int64_t column);
  bool fix(std::int64_t column) const;
  void poll(int rank, double operations) noexcept;

  const FrontLayout& layout_;
  const Kernels& kernels_;
  Schedule schedule_;
  WorkerPool& pool_;
  AlignedBuffer factor_, common_;
  // Where the contribution blocks between threads are, and the front of the boundary.
  double *shared_ = nullptr, *boundary_ = nullptr;
  std::vector<AlignedBuffer> own_;  // of each thread
  // Of each pivot: 1 / sqrt(pivot), and epsilon times its diagonal entry before the elimination. A
  // pivot that is not greater than that floor has failed.
  std::vector<double> reciprocal_, floor_;
  std::span<const double> values_, damping_;
  std::span<const Element> elements_;
  const Fixing* fixing_ = nullptr;
  std::atomic<std::int64_t> failed_{0};  // the first column so far whose pivot failed
  InterruptPoll poll_;
  std::exception_ptr interruption_;  // thrown in the first thread, and not yet by factorize
};

}  // namespace masat
