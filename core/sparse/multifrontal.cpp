#include "sparse/multifrontal.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "sparse/block_size.hpp"

namespace masat {
namespace {

// By how much the damping of a fixed node grows if its pivot fails again.
constexpr double kFixingGrowth = 1e6;
// Values of `failed_` that are no column: no pivot has failed, and stop at once.
constexpr std::int64_t kNone = std::numeric_limits<std::int64_t>::max(), kStopped = -1;

template <int kSize>
void copy_block(double* to, std::int64_t ld, const double* from, bool transposed) {
  if (transposed) {
    for (int j = 0; j < kSize; ++j) {
      for (int i = 0; i < kSize; ++i) to[j * ld + i] = from[i * kSize + j];
    }
  } else {
    for (int j = 0; j < kSize; ++j) {
      for (int i = 0; i < kSize; ++i) to[j * ld + i] = from[j * kSize + i];
    }
  }
}

// Workspace of the factorization of parts, which are many and take their turns: one for each thread
// that calls it. It holds the values of the last one.
struct Workspace {
  AlignedBuffer buffer;
  std::int64_t size = 0;
  const Multifrontal* user = nullptr;

  void free() {
    buffer = AlignedBuffer();
    size = 0;
    user = nullptr;
  }
  double* lend(const Multifrontal* to, std::int64_t doubles) {
    if (doubles > size) {
      free();
      buffer = AlignedBuffer(doubles);
      size = doubles;
    }
    user = to;
    return buffer.data();
  }
};
thread_local Workspace workspace;

std::int32_t chunks(std::int32_t count, std::int32_t size) { return (count + size - 1) / size; }

}  // namespace

Multifrontal::Multifrontal(const FrontLayout& layout, const Kernels& kernels, WorkerPool& pool)
    : layout_(layout),
      kernels_(kernels),
      schedule_(layout, pool.threads()),
      pool_(pool),
      factor_(layout.factor_size()) {
  if (layout.tree().boundary == 0) {
    common_ = AlignedBuffer(schedule_.common_size);
    shared_ = common_.data();
  }
  if (!schedule_.subtrees.empty()) {
    for (int t = 0; t < pool_.threads(); ++t) own_.emplace_back(schedule_.thread_size);
  }
  const std::size_t scalars = layout.tree().order.size() * layout.block_size();
  reciprocal_.resize(scalars);
  floor_.resize(scalars);
}

void Multifrontal::free_workspace() { workspace.free(); }

std::int32_t Multifrontal::factorize(std::span<const double> values,
                                     std::span<const double> damping,
                                     std::span<const Element> elements) {
  values_ = values;
  damping_ = damping;
  elements_ = elements;
  failed_.store(kNone, std::memory_order_relaxed);
  if (layout_.tree().boundary > 0) {
    const std::int64_t common = (schedule_.common_size + 7) / 8 * 8;
    shared_ = workspace.lend(this, common + layout_.boundary_size());
    boundary_ = shared_ + common;
  }
  {
    const WorkerPool::Session session(pool_);
    pool_.for_each(static_cast<std::int32_t>(schedule_.subtrees.size()),
                   [this](std::int32_t s, int rank) {
                     const Subtree& subtree = schedule_.subtrees[s];
                     const Solo solo{rank};
                     for (std::int32_t f = subtree.first; f <= subtree.last && matters(f); ++f) {
                       process(f, rank, solo);
                     }
                   });
    for (const Schedule::TopFront& top : schedule_.top) {
      if (!matters(top.front)) break;
      if (top.shared) {
        process(top.front, 0, pool_);
      } else {
        process(top.front, 0, Solo{0});
      }
    }
  }
  if (interruption_) std::rethrow_exception(std::exchange(interruption_, nullptr));
  const std::int64_t failed = failed_.load(std::memory_order_relaxed);
  return failed == kNone ? -1 : static_cast<std::int32_t>(failed / layout_.block_size());
}

std::vector<char> Multifrontal::fix_failing(std::span<const double> values,
                                            std::span<double> damping,
                                            std::span<const double> fixing) {
  std::vector<char> fixed(layout_.tree().order.size());
  const Fixing context{damping, fixing, fixed};
  struct Reset {
    const Fixing*& pointer;
    ~Reset() { pointer = nullptr; }
  };
  fixing_ = &context;
  const Reset reset{fixing_};
  // Numbers that are not finite can fail all the same; the flags are then what is known.
  static_cast<void>(factorize(values, damping));
  return fixed;
}

Front Multifrontal::boundary() const {
  if (workspace.user != this || workspace.buffer.data() != shared_) throw OverwrittenByOther();
  return layout_.front(layout_.fronts() - 1, boundary_);
}

double Multifrontal::pivot_ratio() const {
  constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
  double largest = 1;  // ratio of a diagonal entry to its pivot, which rounding may make less
  for (std::size_t k = 0; k < floor_.size(); ++k) {
    largest = std::max(largest, floor_[k] / kEpsilon * (reciprocal_[k] * reciprocal_[k]));
  }
  return 1 / largest;
}

// Fronts after a failed pivot do not matter. All fronts before it are computed, so that the first
// failed pivot is found for any number of threads.
bool Multifrontal::matters(std::int32_t f) const {
  return layout_.first(f) < failed_.load(std::memory_order_relaxed);
}

// Notices Ctrl-C in the thread that called factorize. No front matters from then on.
void Multifrontal::poll(int rank, double operations) noexcept {
  if (rank != 0) return;
  try {
    poll_.add(operations);
  } catch (...) {
    interruption_ = std::current_exception();
    failed_.store(kStopped, std::memory_order_relaxed);
  }
}

double* Multifrontal::contribution(std::int32_t f, int rank) const {
  return (schedule_.in_common[f] ? shared_ : own_[rank].data()) + schedule_.contribution[f];
}

template <class Threads>
void Multifrontal::process(std::int32_t f, int rank, Threads&& threads) {
  constexpr std::int32_t kPanel = Kernels::kPanel, kTile = Kernels::kTile;
  double* const to = layout_.tree().is_boundary(f) ? boundary_ : values(f);
  const Front front = layout_.front(f, to, contribution(f, rank));
  if (const std::int32_t element = layout_.tree().element[f]; element >= 0) {
    return copy_element(front.cb, f, elements_[element]);
  }
  // The number of rows of whole blocks in about a panel.
  const std::int32_t whole = kPanel / layout_.block_size() * layout_.block_size();
  std::int32_t failed;
  do {
    threads.for_each(chunks(front.pivots, whole), [&](std::int32_t i, int) {
      assemble_pivots(front, f, rank, i * whole, std::min((i + 1) * whole, front.pivots));
    });
    if (layout_.tree().is_boundary(f)) return;
    failed = eliminate(front, f, rank, threads);
  } while (failed >= 0 && matters(f) && fix(layout_.first(f) + failed));
  if (failed >= 0) return report_failed(layout_.first(f) + failed);
  // The longest rows first, to balance the threads.
  const std::int32_t tiles = chunks(front.rows, kTile);
  threads.for_each(tiles, [&](std::int32_t i, int task_rank) {
    const std::int32_t first = (tiles - 1 - i) * kTile;
    poll(task_rank, double(kTile) * first * front.pivots);
    if (!matters(f)) return;
    kernels_.update_rows(front, first, std::min(first + kTile, front.rows));
  });
  if (layout_.children(f).empty()) return;
  threads.for_each(chunks(front.rows, kPanel), [&](std::int32_t i, int) {
    add_children(front, f, rank, front.pivots + i * kPanel,
                 front.pivots + std::min((i + 1) * kPanel, front.rows));
  });
}

// Sets the contribution block of an element, whose rows are in the elimination order.
void Multifrontal::copy_element(double* to, std::int32_t f, const Element& element) const {
  const AssemblyTree& tree = layout_.tree();
  const std::int64_t ld = layout_.shape(f).ld21;
  const int d = layout_.block_size();
  const std::int64_t scalars = static_cast<std::int64_t>(element.nodes.size()) * d;
  std::vector<std::int64_t> given;  // the first scalar of each row's node in the element
  for (const std::int32_t row : tree.rows(f)) {
    const auto found = std::find(element.nodes.begin(), element.nodes.end(), tree.order[row]);
    given.push_back((found - element.nodes.begin()) * d);
  }
  const auto value = [&](std::int64_t i, std::int64_t j) {
    if (i < j) std::swap(i, j);
    return element.block[j * scalars - j * (j - 1) / 2 + i - j];
  };
  for (std::size_t column = 0; column < given.size(); ++column) {
    for (int j = 0; j < d; ++j, to += ld) {
      for (std::size_t row = column; row < given.size(); ++row) {
        for (int i = 0; i < d; ++i) {
          to[static_cast<std::int64_t>(row) * d + i] = value(given[row] + i, given[column] + j);
        }
      }
    }
  }
}

void Multifrontal::assemble_pivots(const Front& front, std::int32_t f, int rank, std::int32_t begin,
                                   std::int32_t end) {
  std::fill(front.l11 + begin * front.ld11, front.l11 + end * front.ld11, 0.0);
  std::fill(front.l21 + begin * front.ld21, front.l21 + end * front.ld21, 0.0);
  const int d = layout_.block_size();
  void (*copy)(double*, std::int64_t, const double*, bool) = nullptr;
  with_block_size(d, [&]<int kSize>() { copy = copy_block<kSize>; });
  const std::int32_t first = layout_.tree().first[f];
  for (std::int32_t k = first + begin / d; k < first + end / d; ++k) {
    for (const BlockEntry& entry : layout_.entries(k)) {
      copy(front.l11 + entry.target, entry.below ? front.ld21 : front.ld11,
           values_.data() + std::int64_t{entry.source} * d * d, entry.transposed);
    }
    const std::int64_t node = std::int64_t{layout_.tree().order[k]} * d;
    double* const diagonal = front.l11 + std::int64_t{k - first} * d * (front.ld11 + 1);
    for (int i = 0; i < d; ++i) {
      double& value = diagonal[i * (front.ld11 + 1)];
      value += damping_[node + i];
      floor_[std::int64_t{k} * d + i] = std::numeric_limits<double>::epsilon() * value;
    }
  }
  add_children(front, f, rank, begin, end);
}

void Multifrontal::add_children(const Front& front, std::int32_t f, int rank, std::int32_t begin,
                                std::int32_t end) {
  for (const std::int32_t c : layout_.children(f)) {
    const std::span<const Run> runs = layout_.runs(c);
    kernels_.extend_add(front, contribution(c, rank), layout_.shape(c).ld21, false, runs.data(),
                        static_cast<std::int64_t>(runs.size()), begin, end);
  }
}

// Returns -1, or the pivot of the front that failed.
template <class Threads>
std::int32_t Multifrontal::eliminate(const Front& front, std::int32_t f, int rank,
                                     Threads&& threads) {
  constexpr std::int32_t kPanel = Kernels::kPanel, kTile = Kernels::kTile;
  const std::int64_t column = layout_.first(f);
  double* const reciprocal = reciprocal_.data() + column;
  for (std::int32_t begin = 0; begin < front.pivots; begin += kPanel) {
    poll(rank, double(kPanel) * (begin + kPanel) * (front.pivots - begin + front.rows));
    if (!matters(f)) return -1;
    const std::int32_t failed =
        kernels_.factor_diagonal(front, begin, reciprocal, floor_.data() + column);
    if (failed >= 0) return failed;
    const std::int32_t end = std::min(begin + kPanel, front.pivots);
    const std::int32_t inside = chunks(front.pivots - end, kTile);
    threads.for_each(inside + chunks(front.rows, kTile), [&](std::int32_t i, int) {
      const bool below = i >= inside;
      const std::int32_t first = below ? (i - inside) * kTile : end + i * kTile;
      const std::int32_t last = std::min(first + kTile, below ? front.rows : front.pivots);
      kernels_.solve_rows(front, begin, reciprocal, below, first, last);
    });
  }
  return -1;
}

// Fixes the node of a failed pivot. Returns false if no node is to be fixed, or if its damping is
// no longer finite.
bool Multifrontal::fix(std::int64_t column) const {
  if (!fixing_) return false;
  const int d = layout_.block_size();
  const std::int32_t node = layout_.tree().order[column / d];
  double* const damping = &fixing_->damping[std::int64_t{node} * d];
  // A pivot just above its floor can change the diagonal entries of its neighbors by more than the
  // first damping of a fixed node.
  for (int i = 0; i < d; ++i) {
    damping[i] = fixing_->fixed[node] ? kFixingGrowth * damping[i]
                                      : fixing_->fixing[std::int64_t{node} * d + i];
  }
  fixing_->fixed[node] = 1;
  return std::all_of(damping, damping + d, [](double v) { return std::isfinite(v); });
}

void Multifrontal::report_failed(std::int64_t column) {
  std::int64_t known = failed_.load(std::memory_order_relaxed);
  while (column < known && !failed_.compare_exchange_weak(known, column)) {
  }
}

}  // namespace masat
