// An incremental multifrontal Cholesky factorization of a growing graph's H.
// Kaess, Johannsson, Roberts, Ila, Leonard, Dellaert, "iSAM2: Incremental smoothing and mapping
// using the Bayes tree", IJRR 2012: what changes in the factor are the fronts on the paths from the
// touched nodes to the roots.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "online/dense_front.hpp"
#include "online/growing_graph.hpp"
#include "online/minimum_degree.hpp"
#include "online/partial_tree.hpp"
#include "sparse/aligned_buffer.hpp"
#include "sparse/front_cost.hpp"
#include "sparse/front_layout.hpp"
#include "sparse/kernels.hpp"

namespace masat {

// H is not positive definite at a node, whatever the damping.
struct SingularAt : std::runtime_error {
  explicit SingularAt(std::int32_t n) : runtime_error("singular"), node(n) {}
  std::int32_t node;
};

// Fronts own their memory. A front whose parent is computed anew keeps its values, but the order of
// its rows is then that of an earlier step.
template <LieGroup Group>
class GrowingFactor {
 public:
  static constexpr int kDof = Group::kDof;
  using Graph = GrowingGraph<Group>;

  struct OwnFront {
    Front dense;           // the factor; its own contribution block is packed
    double* reciprocal;    // of the pivots' square roots
    double* solved;        // L^-1 of the right-hand side, at the pivots
    double* below;         // what the front and its descendants add to that of the rows
    double* contribution;  // what they subtract from the matrix of the rows, packed
    AlignedBuffer memory;
    std::int64_t doubles = 0;              // of the memory
    std::int32_t pivots = 0, parent = -1;  // pivots in nodes; 0 if the front is not in use
    std::int64_t made = 0;                 // the elimination that computed it
    std::vector<std::int32_t> nodes;       // pivots, then rows
    std::vector<std::int32_t> children;
    std::span<const std::int32_t> rows() const {
      return {nodes.data() + pivots, nodes.size() - static_cast<std::size_t>(pivots)};
    }
  };

  // Numbers of fronts.
  std::span<const std::int32_t> newest() const { return newest_; }  // children before parents
  bool is_newest(std::int32_t f) const { return fronts_[f].made == elimination_; }
  const OwnFront& front(std::int32_t f) const { return fronts_[f]; }
  std::size_t nodes() const { return front_of_.size(); }
  // The front that eliminates a node, or -1 for fixed and new ones.
  std::int32_t front_of(std::int32_t node) const { return front_of_[node]; }

  void resize(std::int32_t nodes) {
    front_of_.resize(nodes, -1);
    local_.resize(nodes, -1);
    touched_flag_.resize(nodes, 0);
  }

  // Marks a node whose neighbors change, or that is to be ordered anew.
  void touch(std::int32_t node) {
    touch_values(node);
    orders_ = true;
  }
  // Marks a node whose blocks change.
  void touch_values(std::int32_t node) {
    if (touched_flag_[node]) return;
    touched_flag_[node] = 1;
    touched_.push_back(node);
  }
  bool anything_touched() const { return !touched_.empty(); }

  // Drops the fronts on the paths from the touched nodes to the roots. The nodes that they
  // eliminated, and new ones, are `dropped()` until `eliminate` orders and eliminates them again.
  // Where only values have changed and that takes little time, the order stays, and so do the
  // fronts until they are computed again.
  void drop(const Graph& graph);
  std::span<const std::int32_t> dropped() const { return dropped_; }
  bool is_dropped(std::int32_t node) const { return local_[node] >= 0; }
  void eliminate(Graph& graph);

  // Nodes that have been damped, since their pivots failed, and not been forgotten here.
  std::span<const std::int32_t> damped() const { return damped_; }
  void forget_damped() { damped_.clear(); }

  // The fill that the factor would have if all nodes were ordered now.
  std::int64_t fill_of_fresh_order(const Graph& graph);
  // Scalars of the factor without padding, and the bytes of all memory.
  std::int64_t fill() const { return fill_; }
  std::int64_t bytes() const { return 8 * doubles_; }
  std::int64_t refactored() const { return refactored_; }  // nodes, in all

 private:
  void drop_paths(const Graph& graph);
  double reopen_paths();
  void order(const Graph& graph);
  void build_fronts();
  std::int32_t new_front(std::int32_t f);
  void compute(Graph& graph, OwnFront& front);
  void assemble(Graph& graph, OwnFront& front);
  void add_children(OwnFront& front, bool to_pivots);
  std::int64_t fill_of(const OwnFront& front) const {
    const std::int64_t p = front.dense.pivots, r = front.dense.rows;
    return p * (p + 1) / 2 + p * r;
  }

  const Kernels* kernels_ = &kernels();
  std::vector<OwnFront> fronts_;
  std::vector<std::int32_t> unused_, newest_;
  std::vector<std::int32_t> front_of_, local_;  // of each node; local: among the dropped ones
  std::vector<char> touched_flag_;
  bool orders_ = false;  // whether the dropped nodes are to be ordered
  std::vector<std::int32_t> touched_, dropped_, dropped_fronts_, boundary_, targets_, slots_,
      damped_;
  std::vector<Run> runs_;
  std::vector<double> floor_;
  AlignedBuffer contribution_;  // of the front that is computed
  std::int64_t contribution_size_ = 0;
  MinimumDegree order_;
  PartialTree tree_;
  std::int64_t fill_ = 0, refactored_ = 0, elimination_ = 0, doubles_ = 0;
};

}  // namespace masat

#include "online/growing_factor_impl.hpp"
