#include "sparse/block_cholesky.hpp"

#include <algorithm>
#include <vector>

#include "sparse/multifrontal.hpp"
#include "sparse/selected_inverse.hpp"
#include "sparse/substitution.hpp"

namespace masat {
namespace {

// Whose rows a task brings into another order: some microseconds of work.
constexpr std::int64_t kNodesPerTask = 2048;

}  // namespace

struct BlockCholesky::Impl {
  Impl(const Elimination& elimination, int d, WorkerPool& pool)
      : layout(elimination.layout(d)),
        factor(layout, kernels(), pool),
        substitution(layout, kernels(), pool) {}

  const FrontLayout& layout;
  Multifrontal factor;
  Substitution substitution;
  bool factorized = false;

  const Multifrontal& checked() const {
    if (!factorized) throw NotFactorized();
    return factor;
  }

  const Multifrontal& whole() const {
    if (layout.tree().boundary > 0) throw PartOnly();
    return checked();
  }

  // Calls solve() with right-hand sides in the elimination order, and brings them back.
  template <class Solve>
  void permuted(std::span<double> rhs, int columns, Solve solve) {
    const std::vector<std::int32_t>& order = layout.tree().order;
    const int d = layout.block_size(), width = columns == 1 ? 1 : kernels().width;
    // Groups of `width` columns; the last group is filled up with zeros.
    substitution.reserve(width, (columns + width - 1) / width);
    WorkerPool& pool = factor.pool();
    const WorkerPool::Session session(pool);
    const auto nodes = static_cast<std::int64_t>(order.size());
    // Calls copy(a value of `rhs`, the same one in the elimination order) for all values.
    const auto exchange = [&](auto copy) {
      for (int first = 0; first < columns; first += width) {
        const int count = std::min(width, columns - first);
        double* const group = substitution.group(first / width);
        pool.for_chunks(nodes, kNodesPerTask, [&](std::int64_t begin, std::int64_t end) {
          double* packed = group + begin * d * width;
          for (std::int64_t k = begin; k < end; ++k) {
            double* own = rhs.data() + std::int64_t{order[k]} * d * columns + first;
            for (int i = 0; i < d; ++i, own += columns, packed += width) {
              for (int c = 0; c < count; ++c) copy(own[c], packed[c]);
            }
          }
        });
      }
    };
    if (const int last = columns / width; columns % width != 0) {
      std::fill(substitution.group(last), substitution.group(last + 1), 0.0);
    }
    exchange([](double& own, double& packed) { packed = own; });
    solve();
    exchange([](double& own, double& packed) { own = packed; });
  }
};

BlockCholesky::BlockCholesky(const Elimination& elimination, int block_size, WorkerPool& pool) {
  impl_ = std::make_unique<Impl>(elimination, block_size, pool);
}
BlockCholesky::~BlockCholesky() = default;

std::int32_t BlockCholesky::factorize(std::span<const double> values,
                                      std::span<const double> damping,
                                      std::span<const Element> elements) {
  impl_->factorized = false;
  const std::int32_t failed = impl_->factor.factorize(values, damping, elements);
  impl_->factorized = failed < 0;
  return failed < 0 ? -1 : impl_->layout.tree().order[failed];
}

std::vector<std::int32_t> BlockCholesky::indefinite(std::span<const double> values,
                                                    std::vector<double> damping,
                                                    std::span<const double> fixing) {
  impl_->factorized = false;
  const std::vector<char> fixed = impl_->factor.fix_failing(values, damping, fixing);
  std::vector<std::int32_t> nodes;
  for (std::size_t k = 0; k < fixed.size(); ++k) {
    if (fixed[k]) nodes.push_back(static_cast<std::int32_t>(k));
  }
  return nodes;
}

bool BlockCholesky::factorized() const { return impl_->factorized; }

double BlockCholesky::pivot_ratio() const { return impl_->checked().pivot_ratio(); }

void BlockCholesky::solve(std::span<double> rhs, int columns) const {
  const Multifrontal& factor = impl_->whole();
  impl_->permuted(rhs, columns, [&] { impl_->substitution.solve(factor); });
}

void BlockCholesky::reduce(std::span<double> rhs) const {
  const Multifrontal& factor = impl_->checked();
  impl_->permuted(rhs, 1, [&] { impl_->substitution.reduce(factor); });
}

void BlockCholesky::substitute(std::span<double> rhs) const {
  const Multifrontal& factor = impl_->checked();
  impl_->permuted(rhs, 1, [&] { impl_->substitution.substitute(factor); });
}

std::vector<double> BlockCholesky::contribution() const {
  const Multifrontal& factor = impl_->checked();
  std::vector<double> out;
  if (impl_->layout.tree().boundary == 0) return out;
  const Front front = factor.boundary();
  out.reserve(std::size_t{1} * front.pivots * (front.pivots + 1) / 2);
  for (std::int32_t j = 0; j < front.pivots; ++j) {
    const double* const column = front.l11 + j * front.ld11;
    out.insert(out.end(), column + j, column + front.pivots);
  }
  return out;
}

void BlockCholesky::inverse(std::span<const std::int32_t> rows,
                            std::span<const std::int32_t> columns, double* out) const {
  invert_blocks(impl_->layout, impl_->whole(), rows, columns, out);
}

}  // namespace masat
