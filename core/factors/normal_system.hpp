// The system to which factors add their parts.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "graph/topology.hpp"
#include "sparse/aligned_buffer.hpp"
#include "sparse/edge_groups.hpp"
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
  NormalSystem(GraphMatrix& matrix, std::span<const Edge> edges)
      : matrix_(matrix),
        groups_(*matrix.elimination(), edges, kBlock * kBlock),
        rhs_(matrix.rows()),
        cells_(kCell * static_cast<std::int64_t>(groups_.cell_node.size())),
        costs_(groups_.count()) {}

  const std::vector<double>& rhs() const { return rhs_; }
  std::vector<double> take_rhs() && { return std::move(rhs_); }

  // Adds an edge with the Jacobians of the nodes it leads from and to, W and W e.
  class Adder {
   public:
    Adder(NormalSystem& system, const EdgeGroups::Entry& entry) : system_(system), entry_(entry) {}

    [[gnu::always_inline]] void add_edge(const Square& from, const Square& to, const Square& w,
                                         const Column& we) {
      if (entry_.from != EdgeGroups::kFixed) {
        const Square w_from = w * from;
        system_.add_node(entry_.from, from, w_from, we);
        if (entry_.to != EdgeGroups::kFixed) {
          if (entry_.joint >= 0) {
            Eigen::Map<Square>(system_.matrix_.block(entry_.joint)).noalias() +=
                to.transpose() * w_from;
          } else {
            Eigen::Map<Square>(system_.matrix_.block(~entry_.joint)).noalias() +=
                w_from.transpose() * to;
          }
        }
      }
      if (entry_.to != EdgeGroups::kFixed) system_.add_node(entry_.to, to, w * to, we);
    }

   private:
    NormalSystem& system_;
    const EdgeGroups::Entry& entry_;
  };

  const EdgeGroups& groups() const { return groups_; }

  // Sets the system to what add(group) adds for each group of edges, and returns the sum of what it
  // returns. Calls for different groups may run at the same time.
  template <class Add>
  double assemble(Add add) {
    WorkerPool& pool = matrix_.pool();
    const WorkerPool::Session session(pool);
    matrix_.set_zero();
    std::fill(rhs_.begin(), rhs_.end(), 0.0);
    pool.for_each(groups_.count(), [&](std::int32_t group, int) {
      costs_[group] = add(group);
    });
    pool.for_each(groups_.count(), [&](std::int32_t group, int) { add_cells(group); });
    double cost = 0;
    for (const double c : costs_) cost += c;
    return cost;
  }

 private:
  // The numbers of a cell: a block and a part of the right-hand side.
  static constexpr std::int64_t kCell = kBlock * kBlock + kBlock;

  // `wj` may be a product that is still to be computed, which is faster than a matrix.
  template <class Product>
  [[gnu::always_inline]] void add_node(std::int32_t target, const Square& j, const Product& wj,
                                       const Column& we) {
    double* block;
    double* part;
    if (target >= 0) {
      block = matrix_.node_block(target);
      part = &rhs_[std::int64_t{kBlock} * target];
    } else {
      block = cells_.data() + kCell * ~target;
      part = block + kBlock * kBlock;
      std::fill_n(block, kCell, 0.0);
    }
    Eigen::Map<Square>(block).noalias() += j.transpose() * wj;
    Eigen::Map<Column>(part).noalias() -= j.transpose() * we;
  }

  // Adds what edges of other groups have for the nodes of a group.
  void add_cells(std::int32_t group) {
    for (std::int64_t k = groups_.cell_start[group]; k < groups_.cell_start[group + 1]; ++k) {
      const std::int32_t node = groups_.cell_node[k];
      const double* const cell = cells_.data() + kCell * k;
      Eigen::Map<Square>(matrix_.node_block(node)) += Eigen::Map<const Square>(cell);
      Eigen::Map<Column>(&rhs_[std::int64_t{kBlock} * node]) +=
          Eigen::Map<const Column>(cell + kBlock * kBlock);
    }
  }

  GraphMatrix& matrix_;
  EdgeGroups groups_;
  std::vector<double> rhs_;
  AlignedBuffer cells_;
  std::vector<double> costs_;  // of each group
};

}  // namespace masat
