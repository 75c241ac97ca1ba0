// The system to which factors add their parts.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "graph/topology.hpp"
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
        rhs_(groups_.block.size() * kBlock),
        costs_(groups_.count()) {
    matrix.set_cells(static_cast<std::int64_t>(groups_.cell_node.size()));
  }

  std::span<const double> rhs() const { return {rhs_.data(), rhs_.data() + matrix_.rows()}; }
  std::vector<double> take_rhs() && {
    rhs_.resize(matrix_.rows());
    return std::move(rhs_);
  }

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
          // One product for all cases: the compiler does not inline a second one.
          Square joint;
          joint.noalias() = to.transpose() * w_from;
          if (entry_.flipped) joint.transposeInPlace();
          Eigen::Map<Square> block(system_.matrix_.block(entry_.joint));
          if (entry_.repeated) joint += block;
          block = joint;
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
    // The other blocks are not added to but set.
    const auto nodes_and_cells = static_cast<std::int64_t>(groups_.block.size());
    pool.for_chunks(nodes_and_cells, kBlocksPerTask, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t k = begin; k < end; ++k) block_of(k).setZero();
      std::fill(rhs_.begin() + kBlock * begin, rhs_.begin() + kBlock * end, 0.0);
    });
    pool.for_each(groups_.count(), [&](std::int32_t group, int) { costs_[group] = add(group); });
    pool.for_each(groups_.count(), [&](std::int32_t group, int) { add_cells(group); });
    double cost = 0;
    for (const double c : costs_) cost += c;
    return cost;
  }

 private:
  // Blocks that a task sets to zero: some microseconds of work.
  static constexpr std::int64_t kBlocksPerTask = 2048;

  // `wj` may be a product that is still to be computed, which is faster than a matrix.
  template <class Product>
  [[gnu::always_inline]] void add_node(std::int32_t index, const Square& j, const Product& wj,
                                       const Column& we) {
    block_of(index).noalias() += j.transpose() * wj;
    part_of(index).noalias() -= j.transpose() * we;
  }

  // Adds what other groups have for the nodes of a group.
  void add_cells(std::int32_t group) {
    const auto nodes = static_cast<std::int64_t>(groups_.block.size() - groups_.cell_node.size());
    for (std::int64_t k = groups_.cell_start[group]; k < groups_.cell_start[group + 1]; ++k) {
      block_of(groups_.cell_node[k]) += block_of(nodes + k);
      part_of(groups_.cell_node[k]) += part_of(nodes + k);
    }
  }

  // Of a free node or a cell.
  Eigen::Map<Square> block_of(std::int64_t index) {
    return Eigen::Map<Square>(matrix_.block(groups_.block[index]));
  }
  Eigen::Map<Column> part_of(std::int64_t index) {
    return Eigen::Map<Column>(&rhs_[kBlock * index]);
  }

  GraphMatrix& matrix_;
  EdgeGroups groups_;
  std::vector<double> rhs_;    // of the nodes and the cells
  std::vector<double> costs_;  // of each group
};

}  // namespace masat
