#include "sparse/block_cholesky.hpp"

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "sparse/front_layout.hpp"
#include "sparse/multifrontal.hpp"
#include "sparse/selected_inverse.hpp"

namespace masat {

struct BlockCholesky::Impl {
  Impl(const Elimination& elimination, int d, int threads)
      : layout(elimination.pattern(), elimination.adjacency(), elimination.tree(), d,
               kernels().lanes),
        factor(layout, kernels(), threads),
        permuted(elimination.free_nodes().size() * d) {}

  FrontLayout layout;
  Multifrontal factor;
  std::vector<double> permuted;
};

BlockCholesky::BlockCholesky(const Elimination& elimination, int block_size, int threads) {
  if (block_size < 1 || block_size > 6) throw std::invalid_argument("blocks are of 1 to 6 rows");
  impl_ = std::make_unique<Impl>(elimination, block_size, std::max(threads, 1));
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

}  // namespace masat
