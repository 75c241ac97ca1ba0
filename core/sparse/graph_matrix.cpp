#include "sparse/graph_matrix.hpp"

#include <algorithm>
#include <thread>
#include <utility>

#include "sparse/block_size.hpp"

namespace masat {
namespace {

// A thread for so many nodes can find work in a matrix that has much fill-in.
constexpr int kNodesPerThread = 64;
// Blocks whose diagonal a task reads: some microseconds of work.
constexpr std::int64_t kBlocksPerTask = 4096;
// Nodes whose rows of a product a task computes.
constexpr std::int64_t kNodesPerTask = 512;

// The numbers do not depend on the threads: more than can work only take memory.
int limit_threads(int asked, std::int32_t nodes) {
  const int most = std::max<int>(std::thread::hardware_concurrency(), 64);
  return std::clamp(asked, 1, std::min(most, 1 + nodes / kNodesPerThread));
}

// out += h v, or h' v, of d x d and d x columns.
template <int kSize, bool kTransposed>
void add_product(const double* h, const double* v, int columns, double* out) {
  for (int i = 0; i < kSize; ++i, out += columns) {
    for (int j = 0; j < kSize; ++j) {
      const double factor = kTransposed ? h[i * kSize + j] : h[j * kSize + i];
      for (int c = 0; c < columns; ++c) out[c] += factor * v[j * columns + c];
    }
  }
}

// The rows of the nodes [begin, end). Each block beside the diagonal is read twice, so that no two
// tasks write the same rows. kColumns is 0 where the number of columns is not a compile-time
// constant.
template <int kSize, int kColumns>
void multiply_rows(const Elimination& elimination, const double* values, const double* v,
                   int given_columns, double* out, std::int64_t begin, std::int64_t end) {
  const int columns = kColumns > 0 ? kColumns : given_columns;
  const std::int64_t step = std::int64_t{kSize} * columns, block = kSize * kSize;
  for (auto node = static_cast<std::int32_t>(begin); node < end; ++node) {
    double* const own = out + step * node;
    std::fill(own, own + step, 0.0);
    const auto neighbors = elimination.adjacency().neighbors(node);  // the greatest one first
    auto next = neighbors.rbegin();
    for (; next != neighbors.rend() && next->node < node; ++next) {
      add_product<kSize, false>(values + block * next->entry, v + step * next->node, columns, own);
    }
    const double* const diagonal = values + block * elimination.pattern().start[node];
    add_product<kSize, true>(diagonal, v + step * node, columns, own);
    for (; next != neighbors.rend(); ++next) {
      add_product<kSize, true>(values + block * next->entry, v + step * next->node, columns, own);
    }
  }
}

}  // namespace

GraphMatrix::GraphMatrix(std::shared_ptr<const Elimination> elimination, int block_size,
                         int threads)
    : elimination_(std::move(elimination)),
      d_(block_size),
      values_(elimination_->pattern().row.size() * block_size * block_size),
      pool_(
          std::make_unique<WorkerPool>(limit_threads(threads, elimination_->pattern().columns()))) {
}

void GraphMatrix::add_edge(const Topology& graph, std::int64_t edge, const double* first,
                           const double* joint, const double* second, const double* values,
                           int columns, double* rhs) {
  const auto add = [&](double* block, const double* from, bool transposed) {
    for (int j = 0; j < d_; ++j) {
      for (int i = 0; i < d_; ++i) block[j * d_ + i] += from[transposed ? j * d_ + i : i * d_ + j];
    }
  };
  const auto add_fixed = [&](std::int32_t index, std::int32_t fixed, bool transposed) {
    double* out = rhs + std::int64_t{index} * d_ * columns;
    for (int i = 0; i < d_; ++i, out += columns) {
      const double* x = values + std::int64_t{fixed} * d_ * columns;
      for (int j = 0; j < d_; ++j, x += columns) {
        const double factor = transposed ? joint[j * d_ + i] : joint[i * d_ + j];
        for (int c = 0; c < columns; ++c) out[c] -= factor * x[c];
      }
    }
  };
  const auto [from, to] = graph.edges()[edge];
  const std::int32_t a = elimination_->index(from), b = elimination_->index(to);
  if (a >= 0) add(node_block(a), first, false);
  if (b >= 0) add(node_block(b), second, false);
  if (a >= 0 && b >= 0) {
    add(joint_block(edge), joint, a < b);
  } else if (a >= 0) {
    add_fixed(a, to, false);
  } else if (b >= 0) {
    add_fixed(b, from, true);
  }
}

void GraphMatrix::diagonal(double* out) const {
  const WorkerPool::Session session(*pool_);
  pool_->for_chunks(pattern().columns(), kBlocksPerTask, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t c = begin; c < end; ++c) {
      const double* const values = block(pattern().start[c]);
      for (int i = 0; i < d_; ++i) out[c * d_ + i] = values[i * (d_ + 1)];
    }
  });
}

void GraphMatrix::multiply(const double* v, int columns, double* out) const {
  const WorkerPool::Session session(*pool_);
  with_block_size(d_, [&]<int kSize>() {
    const auto multiply = columns == 1   ? multiply_rows<kSize, 1>
                          : columns == 2 ? multiply_rows<kSize, 2>
                          : columns == 3 ? multiply_rows<kSize, 3>
                          : columns == 4 ? multiply_rows<kSize, 4>
                          : columns == 5 ? multiply_rows<kSize, 5>
                                         : multiply_rows<kSize, 0>;
    pool_->for_chunks(pattern().columns(), kNodesPerTask,
                      [&](std::int64_t begin, std::int64_t end) {
                        multiply(*elimination_, values_.data(), v, columns, out, begin, end);
                      });
  });
}

}  // namespace masat
