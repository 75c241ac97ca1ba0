#include "sparse/selected_inverse.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <deque>
#include <functional>
#include <utility>
#include <vector>

#include "interrupt.hpp"
#include "sparse/aligned_buffer.hpp"
#include "sparse/worker_pool.hpp"

namespace masat {
namespace {

using Matrix = Eigen::MatrixXd;
using Square = Eigen::Map<Matrix>;
using Factor = Eigen::Map<const Matrix, Eigen::Unaligned, Eigen::OuterStride<>>;
using Rows = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;

// Columns that are solved for together: neighbors in the elimination order share most of their
// paths to the root, and the kernels need several columns to be fast.
constexpr int kBatch = 24;
constexpr int kBatchesAtOnce = 8;  // and thread

// A block of the inverse, by indices in the elimination order.
struct Wanted {
  std::int32_t row, column;
  double* out;
};

// Wanted blocks whose columns are solved for together.
struct Batch {
  const Wanted *begin, *end;
};

class Inverter {
 public:
  Inverter(const FrontLayout& layout, const Multifrontal& factor)
      : layout_(layout), tree_(layout.tree()), factor_(factor), d_(layout.block_size()) {}

  // The front that eliminates an index.
  std::int32_t front_of(std::int32_t index) const {
    const auto next = std::upper_bound(tree_.first.begin(), tree_.first.end(), index);
    return static_cast<std::int32_t>(next - tree_.first.begin()) - 1;
  }
  std::int32_t front_of(const Wanted& w) const { return front_of(std::min(w.row, w.column)); }
  bool in_pattern(const Wanted& w) const {
    return position(front_of(w), std::max(w.row, w.column)) >= 0;
  }

  void invert_fronts(std::vector<Wanted> wanted);
  void solve_columns(std::vector<Wanted> wanted, WorkerPool& pool);

 private:
  Factor l11(const Front& f) const { return {f.l11, f.pivots, f.pivots, {f.ld11}}; }
  Factor l21(const Front& f) const { return {f.l21, f.rows, f.pivots, {f.ld21}}; }

  // The position of an index among the blocks of a front, or -1.
  std::int32_t position(std::int32_t f, std::int32_t index) const {
    if (index < tree_.first[f + 1]) return index - tree_.first[f];
    const std::span<const std::int32_t> rows = tree_.rows(f);
    const auto row = std::lower_bound(rows.begin(), rows.end(), index);
    if (row == rows.end() || *row != index) return -1;
    return tree_.pivots(f) + static_cast<std::int32_t>(row - rows.begin());
  }

  void invert_front(std::int32_t f, const Square* parent, Square& inverse) const;
  void climb(std::int32_t f, std::vector<bool>& seen, std::vector<std::int32_t>& path) const;
  struct Workspace;
  template <class Source>
  void solve_batch(const Batch& batch, const Source& source, Workspace& space) const;
  void forward(std::int32_t f, Rows& x, Rows& below) const;
  void backward(std::int32_t f, Rows& x, Rows& below) const;

  const FrontLayout& layout_;
  const AssemblyTree& tree_;
  const Multifrontal& factor_;
  const int d_;
};

// Computes the entries of the inverse in the pivots and rows of each front that contains a wanted
// block, and of the ancestors of these fronts. From the roots down, since the rows of a front lie
// in its parent.
void Inverter::invert_fronts(std::vector<Wanted> wanted) {
  std::sort(wanted.begin(), wanted.end(), [&](const Wanted& a, const Wanted& b) {
    return std::min(a.row, a.column) > std::min(b.row, b.column);
  });
  std::vector<bool> needed(tree_.fronts(), false);
  std::vector<std::int32_t> fronts;
  for (const Wanted& w : wanted) climb(front_of(w), needed, fronts);
  std::sort(fronts.begin(), fronts.end(), std::greater<>());

  // A subtree is finished before the next one begins, so the fronts on a path form a stack.
  std::vector<std::int64_t> start(tree_.fronts()), end(tree_.fronts());
  std::int64_t highest = 0;
  const auto width = [&](std::int32_t f) {
    return layout_.shape(f).pivots + layout_.shape(f).rows;
  };
  for (const std::int32_t f : fronts) {
    start[f] = tree_.parent[f] < 0 ? 0 : end[tree_.parent[f]];
    end[f] = start[f] + std::int64_t{width(f)} * width(f);
    highest = std::max(highest, end[f]);
  }
  const AlignedBuffer stack(highest);

  InterruptPoll poll;
  auto next = wanted.begin();
  for (const std::int32_t f : fronts) {
    poll.add(std::pow(width(f), 3));
    const std::int32_t p = tree_.parent[f];
    Square inverse(stack.data() + start[f], width(f), width(f));
    if (p < 0) {
      invert_front(f, nullptr, inverse);
    } else {
      const Square above(stack.data() + start[p], width(p), width(p));
      invert_front(f, &above, inverse);
    }
    for (; next != wanted.end() && front_of(*next) == f; ++next) {
      Rows(next->out, d_, d_) =
          inverse.block(position(f, next->row) * d_, position(f, next->column) * d_, d_, d_);
    }
  }
}

// With G = L21 L11^-1 and the inverse R in the rows, -R G lies left of R and
// (L11 L11')^-1 + G' R G above that.
void Inverter::invert_front(std::int32_t f, const Square* parent, Square& inverse) const {
  const Front front = factor_.front(f);
  const std::int32_t pivots = front.pivots, rows = front.rows;
  if (parent != nullptr) {
    const std::span<const Run> runs = layout_.runs(f);
    for (const Run& to : runs) {
      for (const Run& from : runs) {
        inverse.block(pivots + from.source, pivots + to.source, from.length, to.length) =
            parent->block(from.target, to.target, from.length, to.length);
      }
    }
  }
  Matrix x = Matrix::Identity(pivots, pivots);
  l11(front).triangularView<Eigen::Lower>().solveInPlace(x);
  Matrix own(pivots, pivots);
  own.triangularView<Eigen::Lower>() = x.transpose() * x;
  if (rows > 0) {
    const Matrix g = l21(front) * x;
    auto left = inverse.bottomLeftCorner(rows, pivots);
    left.noalias() = -inverse.bottomRightCorner(rows, rows) * g;
    own.triangularView<Eigen::Lower>() -= g.transpose() * left;
    inverse.topRightCorner(pivots, rows) = left.transpose();
  }
  inverse.topLeftCorner(pivots, pivots) = own.selfadjointView<Eigen::Lower>();
}

// Appends a front and its ancestors up to the first one that has been seen.
void Inverter::climb(std::int32_t f, std::vector<bool>& seen,
                     std::vector<std::int32_t>& path) const {
  for (; f >= 0 && !seen[f]; f = tree_.parent[f]) {
    seen[f] = true;
    path.push_back(f);
  }
}

// What a thread needs to solve for a batch of columns.
struct Inverter::Workspace {
  Workspace(std::int64_t size, std::int64_t widest, std::int64_t columns, std::int32_t fronts)
      : x_store(size * columns, 0.0),
        below_store(widest * columns),
        x(x_store.data(), size, columns),
        below(below_store.data(), widest, columns),
        up(fronts, false),
        down(fronts, false) {}

  std::vector<double> x_store, below_store;
  Rows x, below;  // x is zero between two batches
  std::vector<bool> up, down;
  std::vector<std::int32_t> rising, falling;
};

void Inverter::solve_columns(std::vector<Wanted> wanted, WorkerPool& pool) {
  // Of a pair of nodes, solve for the one that occurs in more pairs.
  std::vector<std::int32_t> uses(tree_.order.size(), 0);
  for (const Wanted& w : wanted) {
    ++uses[w.row];
    ++uses[w.column];
  }
  const auto source = [&](const Wanted& w) {
    return uses[w.row] > uses[w.column] ? w.row : w.column;
  };
  std::sort(wanted.begin(), wanted.end(),
            [&](const Wanted& a, const Wanted& b) { return source(a) < source(b); });
  const std::int64_t nodes = std::min<std::int64_t>(std::max(1, kBatch / d_), wanted.size());
  std::vector<Batch> batches;
  for (std::size_t k = 0, used = nodes; k < wanted.size(); ++k) {
    const bool is_new = k == 0 || source(wanted[k]) != source(wanted[k - 1]);
    if (is_new && used == std::size_t(nodes)) {
      batches.push_back({&wanted[k], &wanted[k]});
      used = 0;
    }
    used += is_new;
    batches.back().end = &wanted[k] + 1;
  }

  std::int64_t widest = 0;
  for (std::int32_t f = 0; f < tree_.fronts(); ++f) {
    widest = std::max<std::int64_t>(widest, layout_.shape(f).rows);
  }
  // Fewer batches than threads have a workspace each, more of them share that of their thread.
  const auto count = static_cast<std::int32_t>(batches.size());
  const bool few = count < pool.threads();
  std::deque<Workspace> spaces;
  for (int k = 0; k < (few ? count : pool.threads()); ++k) {
    spaces.emplace_back(tree_.order.size() * d_, widest, nodes * d_, tree_.fronts());
  }
  const WorkerPool::Session session(pool);
  // A few batches at a time, between which Ctrl-C is noticed.
  const std::int32_t step = kBatchesAtOnce * pool.threads();
  for (std::int32_t first = 0; first < count; first += step) {
    check_interrupt();
    pool.for_each(std::min(step, count - first), [&](std::int32_t k, int rank) {
      solve_batch(batches[first + k], source, spaces[few ? k : rank]);
    });
  }
}

template <class Source>
void Inverter::solve_batch(const Batch& batch, const Source& source, Workspace& space) const {
  Rows& x = space.x;
  space.rising.clear();
  space.falling.clear();
  std::int64_t at = -d_;
  for (const Wanted* w = batch.begin; w != batch.end; ++w) {
    const std::int32_t column = source(*w);
    if (w == batch.begin || column != source(w[-1])) {
      at += d_;
      x.block(std::int64_t{column} * d_, at, d_, d_).setIdentity();
      climb(front_of(column), space.up, space.rising);
    }
    climb(front_of(w->row + w->column - column), space.down, space.falling);
  }
  std::sort(space.rising.begin(), space.rising.end());
  std::sort(space.falling.begin(), space.falling.end(), std::greater<>());
  for (const std::int32_t f : space.rising) forward(f, x, space.below);
  for (const std::int32_t f : space.falling) backward(f, x, space.below);
  at = -d_;
  for (const Wanted* w = batch.begin; w != batch.end; ++w) {
    const std::int32_t column = source(*w);
    if (w == batch.begin || column != source(w[-1])) at += d_;
    const std::int64_t row = std::int64_t{w->row} + w->column - column;
    const auto solved = x.block(row * d_, at, d_, d_);
    if (w->column != column) {
      Rows(w->out, d_, d_) = solved.transpose();
    } else {
      Rows(w->out, d_, d_) = solved;
    }
  }
  for (const auto& [path, seen] :
       {std::pair{&space.rising, &space.up}, std::pair{&space.falling, &space.down}}) {
    for (const std::int32_t f : *path) {
      (*seen)[f] = false;
      x.middleRows(layout_.first(f), layout_.shape(f).pivots).setZero();
    }
  }
}

void Inverter::forward(std::int32_t f, Rows& x, Rows& below) const {
  const Front front = factor_.front(f);
  auto own = x.middleRows(layout_.first(f), front.pivots);
  l11(front).triangularView<Eigen::Lower>().solveInPlace(own);
  auto product = below.topRows(front.rows);
  product.noalias() = l21(front) * own;
  std::int64_t from = 0;
  for (const std::int32_t row : tree_.rows(f)) {
    x.middleRows(std::int64_t{row} * d_, d_) -= product.middleRows(from, d_);
    from += d_;
  }
}

void Inverter::backward(std::int32_t f, Rows& x, Rows& below) const {
  const Front front = factor_.front(f);
  auto own = x.middleRows(layout_.first(f), front.pivots);
  auto known = below.topRows(front.rows);
  std::int64_t to = 0;
  for (const std::int32_t row : tree_.rows(f)) {
    known.middleRows(to, d_) = x.middleRows(std::int64_t{row} * d_, d_);
    to += d_;
  }
  own.noalias() -= l21(front).transpose() * known;
  l11(front).transpose().triangularView<Eigen::Upper>().solveInPlace(own);
}

}  // namespace

void invert_blocks(const FrontLayout& layout, const Multifrontal& factor,
                   std::span<const std::int32_t> rows, std::span<const std::int32_t> columns,
                   double* out) {
  Inverter inverter(layout, factor);
  const std::vector<std::int32_t>& index = layout.tree().index;
  std::vector<Wanted> inside, outside;
  for (std::size_t k = 0; k < rows.size(); ++k, out += layout.block_size() * layout.block_size()) {
    const Wanted wanted{index[rows[k]], index[columns[k]], out};
    (inverter.in_pattern(wanted) ? inside : outside).push_back(wanted);
  }
  if (!inside.empty()) inverter.invert_fronts(std::move(inside));
  if (!outside.empty()) inverter.solve_columns(std::move(outside), factor.pool());
}

}  // namespace masat
