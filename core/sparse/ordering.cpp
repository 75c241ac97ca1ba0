#include "sparse/ordering.hpp"

#include <Eigen/OrderingMethods>
#include <Eigen/SparseCore>

namespace masat {

std::vector<std::int32_t> minimum_degree(const BlockGraph& graph) {
  const std::int32_t n = graph.nodes();
  Eigen::SparseMatrix<double> matrix(n, n);
  int* const start = matrix.outerIndexPtr();
  for (std::int32_t c = 0; c < n; ++c) {
    start[c + 1] = start[c] + static_cast<int>(graph.neighbors(c).size()) + 1;
  }
  matrix.resizeNonZeros(start[n]);
  int* row = matrix.innerIndexPtr();
  for (std::int32_t c = 0; c < n; ++c) {
    *row++ = c;  // without the diagonal, Eigen takes the column for a dense one
    for (const BlockGraph::Neighbor& r : graph.neighbors(c)) *row++ = r.node;
  }
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> order;
  Eigen::internal::minimum_degree_ordering(matrix, order);
  return {order.indices().data(), order.indices().data() + n};
}

}  // namespace masat
