#include "sparse/block_cholesky.hpp"

#include <algorithm>
#include <vector>

#include "sparse/multifrontal.hpp"
#include "sparse/selected_inverse.hpp"

namespace masat {

struct BlockCholesky::Impl {
  Impl(const Elimination& elimination, int d, int threads)
      : layout(elimination.layout(d)),
        factor(layout, kernels(), threads),
        permuted(elimination.free_nodes().size() * d) {}

  const FrontLayout& layout;
  Multifrontal factor;
  std::vector<double> permuted;
  bool factorized = false;

  const Multifrontal& checked() const {
    if (!factorized) throw NotFactorized();
    return factor;
  }

  const Multifrontal& whole() const {
    if (layout.tree().boundary > 0) throw PartOnly();
    return checked();
  }

  // Copies right-hand sides into the elimination order and back, groups of `width` columns after
  // each other.
  template <class Solve>
  void permute(std::span<double> rhs, int columns, int width, Solve solve) {
    const std::vector<std::int32_t>& order = layout.tree().order;
    const int d = layout.block_size();
    // The last group is filled up with zeros.
    permuted.resize(order.size() * d * ((columns + width - 1) / width * width));
    if (columns % width != 0) std::fill(permuted.begin(), permuted.end(), 0.0);
    const auto exchange = [&](auto copy) {
      double* packed = permuted.data();
      for (int first = 0; first < columns; first += width) {
        const int count = std::min(width, columns - first);
        for (const std::int32_t node : order) {
          double* own = rhs.data() + std::int64_t{node} * d * columns + first;
          for (int i = 0; i < d; ++i, own += columns, packed += width) {
            for (int c = 0; c < count; ++c) copy(own[c], packed[c]);
          }
        }
      }
    };
    exchange([](double& own, double& packed) { packed = own; });
    solve(std::span<double>(permuted));
    exchange([](double& own, double& packed) { own = packed; });
  }
};

BlockCholesky::BlockCholesky(const Elimination& elimination, int block_size, int threads) {
  impl_ = std::make_unique<Impl>(elimination, block_size, threads);
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
  const int width = columns == 1 ? 1 : kernels().width;
  impl_->permute(rhs, columns, width, [&](std::span<double> x) { factor.solve(x, width); });
}

void BlockCholesky::reduce(std::span<double> rhs) const {
  const Multifrontal& factor = impl_->checked();
  impl_->permute(rhs, 1, 1, [&](std::span<double> x) { factor.reduce(x); });
}

void BlockCholesky::substitute(std::span<double> rhs) const {
  const Multifrontal& factor = impl_->checked();
  impl_->permute(rhs, 1, 1, [&](std::span<double> x) { factor.substitute(x); });
}

std::vector<double> BlockCholesky::contribution() const {
  const Multifrontal& factor = impl_->checked();
  std::vector<double> out;
  if (impl_->layout.tree().boundary == 0) return out;
  const Front front = factor.front(impl_->layout.fronts() - 1);
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
