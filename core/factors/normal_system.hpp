// The system to which factors add their parts.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "graph/topology.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

// H = sum J' W J and the right-hand side -sum J' W e, for the free nodes of a graph, each with
// kBlock unknowns. Jacobians are given by node; those of fixed nodes are ignored.
template <int kBlock>
class NormalSystem {
 public:
  using Square = Eigen::Matrix<double, kBlock, kBlock>;
  using Column = Eigen::Matrix<double, kBlock, 1>;

  // Uses the matrix's blocks and leaves the system in them. The matrix must outlive it.
  explicit NormalSystem(GraphMatrix& matrix) : matrix_(matrix), rhs_(matrix.rows()) {}

  void set_zero() {
    matrix_.set_zero();
    std::fill(rhs_.begin(), rhs_.end(), 0.0);
  }

  const std::vector<double>& rhs() const { return rhs_; }
  std::vector<double> take_rhs() && { return std::move(rhs_); }

  // Adds an edge with the Jacobians of the nodes it leads from and to, W and W e.
  [[gnu::always_inline]] void add_edge(std::int64_t edge, const Edge& nodes, const Square& from,
                                       const Square& to, const Square& w, const Column& we) {
    const Elimination& elimination = *matrix_.elimination();
    const std::int32_t a = elimination.place(nodes.from), b = elimination.place(nodes.to);
    if (a >= 0) {
      const Square w_from = w * from;
      add_node(a, from, w_from, we);
      if (b >= 0) {
        Eigen::Map<Square> joint(matrix_.joint_block(edge));
        if (a < b) {
          joint.noalias() += to.transpose() * w_from;
        } else {
          joint.noalias() += w_from.transpose() * to;
        }
      }
    }
    if (b >= 0) add_node(b, to, w * to, we);
  }

 private:
  // `wj` may be a product that is still to be computed, which is faster than a matrix.
  template <class Product>
  [[gnu::always_inline]] void add_node(std::int32_t index, const Square& j, const Product& wj,
                                       const Column& we) {
    Eigen::Map<Square>(matrix_.node_block(index)).noalias() += j.transpose() * wj;
    Eigen::Map<Column>(&rhs_[std::int64_t{kBlock} * index]).noalias() -= j.transpose() * we;
  }

  GraphMatrix& matrix_;
  std::vector<double> rhs_;
};

}  // namespace masat
