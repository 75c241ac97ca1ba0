#include "sparse/block_cholesky.hpp"

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "sparse/elimination_tree.hpp"
#include "sparse/front_layout.hpp"
#include "sparse/multifrontal.hpp"
#include "sparse/ordering.hpp"
#include "sparse/selected_inverse.hpp"

namespace masat {

struct BlockCholesky::Impl {
  Impl(const BlockPattern& pattern, const BlockGraph& graph, const EliminationTree& tree, int d,
       int threads)
      : layout(pattern, graph, tree, d, kernels().lanes),
        factor(layout, kernels(), threads),
        permuted(tree.order.size() * d) {
    for (const std::int32_t count : tree.count) {
      for (int k = 0; k < d; ++k) {
        const std::int64_t height = std::int64_t{count} * d - k;
        fill += height;
        operations += double(height) * double(height);
      }
    }
  }

  FrontLayout layout;
  Multifrontal factor;
  std::vector<double> permuted;
  std::int64_t fill = 0;
  double operations = 0;
};

BlockCholesky::BlockCholesky(const BlockPattern& pattern, int block_size, int threads,
                             std::span<const std::int32_t> order) {
  if (block_size != 3 && block_size != 6) throw std::invalid_argument("blocks are 3x3 or 6x6");
  const BlockGraph graph(pattern);
  const EliminationTree tree = order.empty() ? find_elimination_tree(graph, minimum_degree(graph))
                                             : find_elimination_tree(graph, order);
  impl_ = std::make_unique<Impl>(pattern, graph, tree, block_size, std::max(threads, 1));
}
BlockCholesky::~BlockCholesky() = default;

std::int32_t BlockCholesky::factorize(std::span<const double> values,
                                      std::span<const double> damping) {
  const std::int32_t broken = impl_->factor.factorize(values, damping);
  return broken < 0 ? -1 : impl_->layout.tree().order[broken];
}

void BlockCholesky::solve(std::span<double> rhs) const {
  const int d = impl_->layout.block_size();
  const std::vector<std::int32_t>& order = impl_->layout.tree().order;
  double* permuted = impl_->permuted.data();
  for (const std::int32_t node : order) {
    permuted = std::copy_n(rhs.data() + std::int64_t{node} * d, d, permuted);
  }
  impl_->factor.solve(impl_->permuted);
  const double* solved = impl_->permuted.data();
  for (const std::int32_t node : order) {
    std::copy_n(solved, d, rhs.data() + std::int64_t{node} * d);
    solved += d;
  }
}

void BlockCholesky::inverse(std::span<const std::int32_t> rows,
                            std::span<const std::int32_t> columns, double* out) const {
  invert_blocks(impl_->layout, impl_->factor, rows, columns, out);
}

std::int64_t BlockCholesky::fill() const { return impl_->fill; }
double BlockCholesky::operations() const { return impl_->operations; }

}  // namespace masat
