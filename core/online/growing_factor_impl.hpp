// Included by growing_factor.hpp alone.
#pragma once

namespace masat {

template <LieGroup Group>
void GrowingFactor<Group>::drop(const Graph& graph) {
  // Nanoseconds of elimination a node from which on a new order is worth its time.
  constexpr double kWorthOrdering = 2000;
  if (!orders_) orders_ = reopen_paths() > kWorthOrdering * static_cast<double>(dropped_.size());
  if (orders_) drop_paths(graph);
  touched_.clear();
}

// Leaves the fronts on the paths as they are until `eliminate` computes them again, children before
// parents, and returns how long that takes, in nanoseconds.
template <LieGroup Group>
double GrowingFactor<Group>::reopen_paths() {
  double cost = 0;
  ++elimination_;
  newest_.clear();
  for (const std::int32_t node : touched_) {
    touched_flag_[node] = 0;
    for (std::int32_t f = front_of_[node]; f >= 0 && !is_newest(f); f = fronts_[f].parent) {
      fronts_[f].made = elimination_;
      if (fronts_[f].parent < 0) newest_.push_back(f);
    }
  }
  for (std::size_t k = 0; k < newest_.size(); ++k) {
    const OwnFront& front = fronts_[newest_[k]];
    cost += front_cost({front.pivots, static_cast<std::int32_t>(front.rows().size())}, kDof);
    for (std::int32_t p = 0; p < front.pivots; ++p) {
      local_[front.nodes[p]] = 0;
      dropped_.push_back(front.nodes[p]);
    }
    for (const std::int32_t c : front.children) {
      if (is_newest(c)) newest_.push_back(c);
    }
  }
  std::reverse(newest_.begin(), newest_.end());
  return cost;
}

template <LieGroup Group>
void GrowingFactor<Group>::drop_paths(const Graph& graph) {
  dropped_fronts_.clear();
  const auto add = [&](std::int32_t node) {
    if (local_[node] >= 0) return;
    local_[node] = 0;
    dropped_.push_back(node);
  };
  for (const std::int32_t node : touched_) {
    touched_flag_[node] = 0;
    for (std::int32_t f = front_of_[node]; f >= 0 && fronts_[f].pivots > 0;) {
      OwnFront& front = fronts_[f];
      dropped_fronts_.push_back(f);
      for (std::int32_t k = 0; k < front.pivots; ++k) {
        front_of_[front.nodes[k]] = -1;
        if (graph.is_free(front.nodes[k])) add(front.nodes[k]);
      }
      fill_ -= fill_of(front);
      front.pivots = 0;  // it is on the path of a node before
      f = front.parent;
    }
    if (graph.is_free(node)) add(node);
  }
  boundary_.clear();
  for (const std::int32_t f : dropped_fronts_) {
    for (const std::int32_t c : fronts_[f].children) {
      if (fronts_[c].pivots > 0) boundary_.push_back(c);
    }
  }
  for (const std::int32_t f : dropped_fronts_) {
    OwnFront& front = fronts_[f];
    doubles_ -= front.doubles;
    front.memory = {};
    front.parent = -1;
    front.nodes.clear();
    front.children.clear();
    unused_.push_back(f);
  }
}

// Orders the dropped nodes, the newest last.
template <LieGroup Group>
void GrowingFactor<Group>::order(const Graph& graph) {
  std::sort(dropped_.begin(), dropped_.end());
  const auto count = static_cast<std::int32_t>(dropped_.size());
  for (std::int32_t k = 0; k < count; ++k) local_[dropped_[k]] = k;
  order_.start(count, 1);
  for (const std::int32_t c : boundary_) {
    targets_.clear();
    for (const std::int32_t node : fronts_[c].rows()) targets_.push_back(local_[node]);
    order_.add_element(targets_);
  }
  for (std::int32_t k = 0; k < count; ++k) {
    for (const std::int32_t slot : graph.node(dropped_[k]).edges) {
      const std::int32_t other = local_[graph.other_end(graph.edge(slot), dropped_[k])];
      if (other > k) order_.add_pair(k, other);
    }
  }
  order_.order();
  tree_.build(order_, count, kDof);
}

template <LieGroup Group>
std::int64_t GrowingFactor<Group>::fill_of_fresh_order(const Graph& graph) {
  boundary_.clear();
  dropped_.clear();
  for (std::int32_t i = 0; i < graph.size(); ++i) {
    if (graph.is_free(i)) dropped_.push_back(i);
  }
  order(graph);
  std::int64_t fill = 0;
  for (std::int32_t f = 0; f < tree_.fronts(); ++f) {
    const auto pivots = static_cast<std::int64_t>(tree_.pivots(f).size()) * kDof;
    const auto rows = static_cast<std::int64_t>(tree_.rows(f).size()) * kDof;
    fill += pivots * (pivots + 1) / 2 + pivots * rows;
  }
  for (const std::int32_t node : dropped_) local_[node] = -1;
  dropped_.clear();
  return fill;
}

template <LieGroup Group>
void GrowingFactor<Group>::eliminate(Graph& graph) {
  if (orders_) {
    order(graph);
    build_fronts();
    orders_ = false;
  }
  // From here on `local_` is the block of a node in the front that is computed.
  for (const std::int32_t node : dropped_) local_[node] = -1;
  refactored_ += static_cast<std::int64_t>(dropped_.size());
  dropped_.clear();
  for (const std::int32_t f : newest_) compute(graph, fronts_[f]);
}

template <LieGroup Group>
void GrowingFactor<Group>::build_fronts() {
  newest_.clear();
  ++elimination_;
  for (std::int32_t f = 0; f < tree_.fronts(); ++f) newest_.push_back(new_front(f));
  for (std::int32_t f = 0; f < tree_.fronts(); ++f) {
    if (tree_.parent(f) < 0) continue;
    fronts_[newest_[f]].parent = newest_[tree_.parent(f)];
    fronts_[newest_[tree_.parent(f)]].children.push_back(newest_[f]);
  }
  for (std::size_t e = 0; e < boundary_.size(); ++e) {
    const std::int32_t parent = newest_[tree_.parent_of_element(static_cast<std::int32_t>(e))];
    fronts_[boundary_[e]].parent = parent;
    fronts_[parent].children.push_back(boundary_[e]);
  }
}

template <LieGroup Group>
std::int32_t GrowingFactor<Group>::new_front(std::int32_t f) {
  std::int32_t number = static_cast<std::int32_t>(fronts_.size());
  if (unused_.empty()) {
    fronts_.emplace_back();
  } else {
    number = unused_.back();
    unused_.pop_back();
  }
  OwnFront& front = fronts_[number];
  front.made = elimination_;
  const auto pivots = tree_.pivots(f), rows = tree_.rows(f);
  front.pivots = static_cast<std::int32_t>(pivots.size());
  for (const std::int32_t local : pivots) {
    front.nodes.push_back(dropped_[local]);
    front_of_[dropped_[local]] = number;
  }
  for (const std::int32_t local : rows) front.nodes.push_back(dropped_[local]);

  Front& dense = front.dense;
  dense.pivots = front.pivots * kDof;
  dense.rows = static_cast<std::int32_t>(rows.size()) * kDof;
  dense.ld11 = leading_dimension(dense.pivots, kernels_->lanes);
  dense.ld21 = leading_dimension(dense.rows, kernels_->lanes);
  front.doubles = (dense.ld11 + dense.ld21) * dense.pivots + 2 * dense.ld11 + dense.ld21 +
                  packed_size(dense.rows);
  doubles_ += front.doubles;
  front.memory = AlignedBuffer(front.doubles);
  dense.l11 = front.memory.data();
  dense.l21 = dense.l11 + dense.ld11 * dense.pivots;
  dense.cb = nullptr;
  front.reciprocal = dense.l21 + dense.ld21 * dense.pivots;
  front.solved = front.reciprocal + dense.ld11;
  front.below = front.solved + dense.ld11;
  front.contribution = front.below + dense.ld21;
  fill_ += fill_of(front);
  return number;
}

template <LieGroup Group>
void GrowingFactor<Group>::compute(Graph& graph, OwnFront& front) {
  const auto blocks = static_cast<std::int32_t>(front.nodes.size());
  for (std::int32_t k = 0; k < blocks; ++k) local_[front.nodes[k]] = k;
  for (;;) {
    assemble(graph, front);
    const std::int32_t failed =
        eliminate_pivots(*kernels_, front.dense, front.reciprocal, floor_.data());
    if (failed < 0) break;
    // The first damping is far above rounding, and far below what changes a solution that is
    // determined; the node is linearized again soon, which ends the damping.
    constexpr double kFirst = 1e-9, kGrowth = 100, kMost = 1e6;
    double& damping = graph.node(front.nodes[failed / kDof]).damping;
    if (damping == 0) damped_.push_back(front.nodes[failed / kDof]);
    damping = damping > 0 ? kGrowth * damping : kFirst;
    if (!(damping < kMost)) {
      for (const std::int32_t node : front.nodes) local_[node] = -1;
      throw SingularAt(front.nodes[failed / kDof]);
    }
  }
  Front& dense = front.dense;
  const std::int64_t size = dense.ld21 * dense.rows;
  if (size > contribution_size_) {
    contribution_size_ = 2 * size;
    contribution_ = AlignedBuffer(contribution_size_);
  }
  dense.cb = contribution_.data();
  update_contribution(*kernels_, dense);
  add_children(front, false);
  pack_contribution(dense, front.contribution);
  dense.cb = nullptr;
  // Overwrites what the children added to the right-hand side of the rows.
  floor_.assign(front.below, front.below + dense.ld21);
  kernels_->forward(dense, front.reciprocal, front.solved, front.below);
  for (std::int64_t k = 0; k < dense.rows; ++k) front.below[k] = floor_[k] - front.below[k];
  for (const std::int32_t node : front.nodes) local_[node] = -1;
}

template <LieGroup Group>
void GrowingFactor<Group>::assemble(Graph& graph, OwnFront& front) {
  using Block = Eigen::Map<Eigen::Matrix<double, kDof, kDof>, 0, Eigen::OuterStride<>>;
  const Front& dense = front.dense;
  std::fill(dense.l11, front.reciprocal, 0.0);
  std::fill(front.solved, front.below + dense.ld21, 0.0);
  floor_.resize(dense.pivots);
  for (std::int32_t k = 0; k < front.pivots; ++k) {
    const std::int32_t node = front.nodes[k];
    graph.refresh(node);
    const auto& own = graph.node(node);
    const std::int64_t column = std::int64_t{k} * kDof;
    Block diagonal(dense.l11 + column * (dense.ld11 + 1), kDof, kDof,
                   Eigen::OuterStride<>(dense.ld11));
    diagonal = own.diagonal;
    diagonal.diagonal() += own.damping * own.diagonal.diagonal();
    for (int i = 0; i < kDof; ++i) {
      floor_[column + i] = std::numeric_limits<double>::epsilon() * diagonal(i, i);
      front.solved[column + i] = own.rhs[i];
    }
    for (const std::int32_t slot : own.edges) {
      const auto& edge = graph.edge(slot);
      const std::int32_t row = local_[graph.other_end(edge, node)];
      if (row <= k) continue;
      const bool below = row >= front.pivots;
      Block joint(below ? dense.l21 + column * dense.ld21 + (row - front.pivots) * kDof
                        : dense.l11 + column * dense.ld11 + row * kDof,
                  kDof, kDof, Eigen::OuterStride<>(below ? dense.ld21 : dense.ld11));
      if (edge.from == node) {
        joint += edge.joint;
      } else {
        joint += edge.joint.transpose();
      }
    }
  }
  add_children(front, true);
}

// Adds the children's contributions, those to the right-hand side with the pivots.
template <LieGroup Group>
void GrowingFactor<Group>::add_children(OwnFront& front, bool to_pivots) {
  for (const std::int32_t c : front.children) {
    const OwnFront& child = fronts_[c];
    runs_.clear();
    slots_.clear();
    bool ascending = true;
    for (const std::int32_t node : child.rows()) {
      const std::int32_t slot = local_[node], at = static_cast<std::int32_t>(slots_.size());
      const bool continues = at > 0 && slot == slots_.back() + 1 && slot != front.pivots;
      ascending &= at == 0 || slot > slots_.back();
      if (continues) {
        runs_.back().length += kDof;
      } else {
        runs_.push_back({at * kDof, slot * kDof, kDof});
      }
      slots_.push_back(slot);
      if (!to_pivots) continue;
      double* const to = slot < front.pivots ? front.solved + slot * kDof
                                             : front.below + (slot - front.pivots) * kDof;
      for (int i = 0; i < kDof; ++i) to[i] += child.below[at * kDof + i];
    }
    const Front& dense = front.dense;
    if (ascending) {
      kernels_->extend_add(dense, child.contribution, child.dense.rows - 1, true, runs_.data(),
                           static_cast<std::int64_t>(runs_.size()), to_pivots ? 0 : dense.pivots,
                           to_pivots ? dense.pivots : dense.pivots + dense.rows);
    } else {
      add_child_in_any_order<kDof>(dense, child.contribution, slots_.data(),
                                   static_cast<std::int32_t>(slots_.size()), to_pivots);
    }
  }
}

}  // namespace masat
