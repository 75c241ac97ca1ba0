// Included by online_map_of.hpp alone.
#pragma once

namespace masat {

template <LieGroup Group>
bool OnlineMapOf<Group>::add_node(std::int64_t id, const double* pose, bool is_point) {
  if (find(id) >= 0 || (pose != nullptr && !is_plain_pose<Group>(pose))) return false;
  const std::int32_t index =
      graph_.add_node(pose == nullptr ? Group{} : Group::load(pose), is_point);
  const std::lock_guard<std::mutex> lock(mutex_);
  index_.emplace(id, index);
  ids_.push_back(id);
  points_.push_back(is_point);
  given_.push_back(pose != nullptr);
  return true;
}

template <LieGroup Group>
bool OnlineMapOf<Group>::add_edges(std::span<const std::int64_t> pairs, const double* measurements,
                                   const double* information, const std::int64_t* numbers) {
  const std::size_t count = pairs.size() / 2, before = pending_.edges.size();
  if (!may_be_numbered(count, numbers)) return false;
  for (std::size_t k = 0; k < count; ++k) {
    const std::int32_t from = find(pairs[2 * k]), to = find(pairs[2 * k + 1]);
    const double* const z = measurements + k * kSize;
    const double* const w = information + k * kDof * kDof;
    if (from < 0 || to < 0 || from == to || graph_.node(from).is_point ||
        graph_.node(to).is_point || !is_plain_pose<Group>(z) || !is_plain_information<Group>(w)) {
      pending_.edges.resize(before);
      return false;
    }
    pending_.edges.push_back({from, to, 0, Group::load(z), Eigen::Map<const Square>(w)});
  }
  wait(before, numbers);
  return true;
}

template <LieGroup Group>
bool OnlineMapOf<Group>::add_sensor_edges(const SensorEdges& edges,
                                          std::span<const bool> may_place) {
  const std::size_t before = pending_.edges.size(), count = edges.ends.size() / 2;
  const std::int64_t* const numbers = edges.numbers.empty() ? nullptr : edges.numbers.data();
  if (!may_be_numbered(count, numbers)) return false;
  for (std::size_t k = 0; k < count; ++k) {
    Joining joining = Joining::kStays;
    if (!may_place.empty()) joining = may_place[k] ? Joining::kPlaces : Joining::kNever;
    pending_.edges.push_back({edges.ends[2 * k], edges.ends[2 * k + 1], 0,
                              Group::load(&edges.measurements[k * kSize]),
                              Eigen::Map<const Square>(&edges.information[k * kDof * kDof]),
                              joining, sensor_of<Group>(edges, k)});
  }
  wait(before, numbers);
  return true;
}

// Whether numbers are those of removed edges, if there are any.
template <LieGroup Group>
bool OnlineMapOf<Group>::may_be_numbered(std::size_t count, const std::int64_t* numbers) const {
  if (numbers == nullptr) return true;
  return std::all_of(numbers, numbers + count, [this](std::int64_t number) {
    return number >= 0 && number < next_edge() && slot_of_[number] == kRemoved;
  });
}

// Numbers the edges that have been added to those that wait, from one on.
template <LieGroup Group>
void OnlineMapOf<Group>::wait(std::size_t before, const std::int64_t* numbers) {
  for (std::size_t k = before; k < pending_.edges.size(); ++k) {
    if (numbers == nullptr) {
      pending_.edges[k].number = next_edge();
      slot_of_.push_back(kWaiting);
    } else {
      pending_.edges[k].number = *numbers;
      slot_of_[*numbers++] = kWaiting;
    }
  }
}

template <LieGroup Group>
bool OnlineMapOf<Group>::remove_edges(std::span<const std::int64_t> numbers) {
  std::vector<std::int64_t> all = pending_.removals;
  for (const std::int64_t number : numbers) {
    if (number < 0 || number >= next_edge() || slot_of_[number] == kRemoved) return false;
    all.push_back(number);
  }
  std::vector<std::int64_t> sorted = all;
  std::sort(sorted.begin(), sorted.end());
  if (std::adjacent_find(sorted.begin(), sorted.end()) != sorted.end()) return false;
  for (const std::int64_t number : numbers) {
    if (slot_of_[number] != kWaiting) {
      pending_.removals.push_back(number);
      continue;
    }
    std::erase_if(pending_.edges, [number](const auto& edge) { return edge.number == number; });
    slot_of_[number] = kRemoved;
  }
  return true;
}

template <LieGroup Group>
StepSummary OnlineMapOf<Group>::update(double budget) {
  constexpr double kUnlimited = 1e6;  // seconds
  const auto deadline =
      Clock::now() + std::chrono::duration_cast<Clock::duration>(
                         std::chrono::duration<double>(std::min(budget, kUnlimited)));
  const std::int64_t refactored = factor_.refactored();
  StepSummary summary;
  root_log_.clear();
  removed_log_.clear();
  added_log_.clear();
  left_out_.clear();
  moved_.clear();
  try {
    apply_changes();
    // An edge that has just been added may have a large residual.
    if (factor_.anything_touched()) solve(reference(std::min(state_.chi2, graph_.chi2())), summary);
    settle(deadline, budget < kUnlimited, summary);
    if (Clock::now() < deadline) reorder_if_worthwhile(summary);
    require_finite_chi2();
  } catch (const SingularAt& at) {
    const std::int64_t id = ids_[at.node];
    roll_back();
    throw Undetermined(id);
  } catch (...) {
    roll_back();
    throw;
  }
  summary.turned = publish();
  summary.chi2 = graph_.chi2();
  summary.refactored = factor_.refactored() - refactored;
  return summary;
}

template <LieGroup Group>
void OnlineMapOf<Group>::apply_changes() {
  resize();
  for (std::int32_t i = all_moved_ ? 0 : state_.nodes; i < graph_.size(); ++i) moved_.push_back(i);
  all_moved_ = false;
  auto& edges = pending_.edges;
  // What waits for another edge to join components, or to place a point, has its turn after it.
  for (std::size_t left = edges.size() + 1; left > edges.size();) {
    left = edges.size();
    std::erase_if(edges, [this](const auto& edge) {
      if (!may_apply(edge)) return false;
      apply(edge);
      return true;
    });
  }
  for (const auto& edge : edges) {
    left_out_.push_back(edge.number);
    slot_of_[edge.number] = kRemoved;
  }
  for (const std::int64_t number : pending_.removals) apply_removal(number);
  pending_.clear();
}

template <LieGroup Group>
bool OnlineMapOf<Group>::may_apply(const PendingEdge<Group>& edge) const {
  if (edge.joining == Joining::kMoves || edge.joining == Joining::kStays) return true;
  if (graph_.node(edge.from).root == graph_.node(edge.to).root) return true;
  return edge.joining == Joining::kPlaces && graph_.is_lone_point(edge.to);
}

template <LieGroup Group>
void OnlineMapOf<Group>::resize() {
  factor_.resize(graph_.size());
  back_.resize(graph_.size());
}

template <LieGroup Group>
void OnlineMapOf<Group>::apply(const PendingEdge<Group>& edge) {
  const std::int32_t newer = graph_.is_lone_point(edge.to) ? edge.to : std::max(edge.from, edge.to);
  const bool keep =
      edge.joining == Joining::kStays || (given_[newer] && graph_.node(newer).edges.empty());
  const std::int32_t freed =
      components_.join(graph_, edge.from, edge.to, edge.measured, keep, moved_, root_log_);
  if (freed >= 0) release_root(freed);
  slot_of_[edge.number] = graph_.add_edge(edge.number, edge.from, edge.to, edge.measured,
                                          edge.information, edge.sensor);
  added_log_.push_back(edge.number);
  factor_.touch(edge.from);
  factor_.touch(edge.to);
}

// A node that is fixed no longer joins its neighbors.
template <LieGroup Group>
void OnlineMapOf<Group>::release_root(std::int32_t root) {
  factor_.touch(root);
  for (const std::int32_t slot : graph_.node(root).edges) {
    factor_.touch(graph_.other_end(graph_.edge(slot), root));
  }
}

template <LieGroup Group>
void OnlineMapOf<Group>::apply_removal(std::int64_t number) {
  const std::int32_t slot = slot_of_[number];
  const auto& e = graph_.edge(slot);
  const PendingEdge<Group> edge{
      e.from, e.to, number, e.measured, e.information, Joining::kStays, graph_.sensor(slot)};
  graph_.remove_edge(slot);
  slot_of_[number] = kRemoved;
  removed_log_.push_back(edge);
  factor_.touch(edge.from);
  factor_.touch(edge.to);
  const std::int32_t fixed = components_.separate(graph_, edge.from, edge.to, root_log_);
  if (fixed < 0) return;
  graph_.relinearize(fixed);
  back_.know(graph_, fixed);
  release_root(fixed);
}

template <LieGroup Group>
void OnlineMapOf<Group>::solve(double cost, StepSummary& summary) {
  // In trials on public graphs, what is not passed on to other fronts raises chi2 by less than a
  // tenth of its bound.
  constexpr double kNotPassedOn = 12;
  // Motion by less than this part of the mean chi2 of an edge changes no residual much.
  constexpr double kNotEvaluated = 0.1;
  ++summary.passes;
  coarsest_ = std::max(coarsest_, cost);
  factor_.drop(graph_);
  const auto edges = static_cast<double>(std::max<std::int64_t>(graph_.edge_count(), 1));
  relinearization_.choose_dropped(graph_, factor_, tolerance_ * cost / 4 / edges);
  relinearization_.apply_to_dropped(graph_);
  for (const std::int32_t node : relinearization_.chosen()) back_.know(graph_, node);
  summary.relinearized += static_cast<std::int64_t>(relinearization_.chosen().size());
  factor_.eliminate(graph_);
  back_.run(graph_, factor_, kNotPassedOn * tolerance_ * cost / graph_.size(),
            tolerance_ > 0 ? kNotEvaluated * cost / edges : 0);
  evaluate();
  summary.changed += static_cast<std::int64_t>(back_.changed().size());
}

// Moves the nodes whose steps have changed, and brings their edges up to date.
template <LieGroup Group>
void OnlineMapOf<Group>::evaluate() {
  seen_edge_.resize(graph_.edge_slots(), 0);
  ++stamp_;
  const auto& changed = back_.changed();
  for (std::size_t k = 0; k < changed.size(); ++k) {
    if (k + kAhead < changed.size()) __builtin_prefetch(&graph_.place(changed[k + kAhead]));
    graph_.update_pose(changed[k]);
  }
  moved_.insert(moved_.end(), changed.begin(), changed.end());
  edges_.clear();
  for (const auto* const nodes : {&back_.moved(), &relinearization_.chosen()}) {
    for (std::size_t k = 0; k < nodes->size(); ++k) {
      if (k + kAhead < nodes->size()) __builtin_prefetch(&graph_.node((*nodes)[k + kAhead]));
      for (const std::int32_t slot : graph_.node((*nodes)[k]).edges) {
        if (seen_edge_[slot] == stamp_) continue;
        seen_edge_[slot] = stamp_;
        edges_.push_back(slot);
      }
    }
  }
  for (std::size_t k = 0; k < edges_.size(); ++k) {
    if (k + kAhead < edges_.size()) graph_.prefetch(edges_[k + kAhead]);
    graph_.evaluate(edges_[k]);
  }
}

// Linearizes again and solves until the tolerance is reached.
template <LieGroup Group>
void OnlineMapOf<Group>::settle(Clock::time_point deadline, bool limited, StepSummary& summary) {
  constexpr std::int32_t kMostPasses = 10;
  constexpr double kLeastTolerance = 1e-18;
  // Edges that are chosen in one pass where time is limited: some tenths of a millisecond.
  constexpr std::size_t kMostChosen = 50;
  // Where chi2 has fallen to this part, what was negligible before may not be so any more.
  constexpr double kFallen = 2;
  bool retried = false;
  for (;;) {
    const double cost = reference(graph_.chi2());
    // If one pass was not enough, the next one goes further, so that few are needed.
    relinearization_.choose(graph_, std::max(tolerance_, kLeastTolerance) * cost,
                            summary.passes < 3 ? 0.1 : 0.01,
                            limited ? kMostChosen : std::numeric_limits<std::size_t>::max());
    // At a pose of their own, damped nodes may do without the damping.
    if (!retried) {
      for (const std::int32_t node : factor_.damped()) relinearization_.add(graph_, node);
    }
    if (relinearization_.chosen().empty()) {
      const bool coarse = coarsest_ > kFallen * cost;
      if (coarse && summary.passes < kMostPasses) {
        solve_all(summary);
        continue;
      }
      summary.complete = !coarse && factor_.damped().empty();
      return factor_.forget_damped();
    }
    if (summary.passes >= kMostPasses || Clock::now() > deadline) {
      summary.complete = false;
      return;
    }
    retried |= !factor_.damped().empty();
    factor_.forget_damped();
    relinearization_.apply(graph_, factor_);
    summary.relinearized += static_cast<std::int64_t>(relinearization_.chosen().size());
    for (const std::int32_t node : relinearization_.chosen()) {
      back_.know(graph_, node);
      moved_.push_back(node);
    }
    solve(cost, summary);
  }
}

// Orders all nodes anew where the factor has grown much beyond that of a fresh order. The test
// costs an order, so it is made only when the factor has grown by half since the last one.
template <LieGroup Group>
void OnlineMapOf<Group>::reorder_if_worthwhile(StepSummary& summary) {
  constexpr double kGrowth = 1.5;
  if (static_cast<double>(factor_.fill()) < kGrowth * tested_fill_) return;
  const auto fresh = static_cast<double>(factor_.fill_of_fresh_order(graph_));
  if (static_cast<double>(factor_.fill()) > kGrowth * fresh) {
    solve_all(summary);
  }
  tested_fill_ = static_cast<double>(factor_.fill());
}

// Orders, factorizes and solves everything, and evaluates all edges.
template <LieGroup Group>
void OnlineMapOf<Group>::solve_all(StepSummary& summary) {
  for (std::int32_t i = 0; i < graph_.size(); ++i) factor_.touch(i);
  coarsest_ = 0;
  solve(reference(graph_.chi2()), summary);
  for (std::int32_t slot = 0; slot < graph_.edge_slots(); ++slot) {
    if (graph_.edge(slot).from >= 0) graph_.evaluate(slot);
  }
}

// The cost to which the tolerance refers: chi2, or a little where measurements agree exactly.
template <LieGroup Group>
double OnlineMapOf<Group>::reference(double chi2) const {
  constexpr double kNegligible = 1e-9;  // chi2 of a measured number
  const auto numbers = kDof * static_cast<double>(std::max<std::int64_t>(graph_.edge_count(), 1));
  return std::max(chi2, kNegligible * numbers);
}

// Huge measurements or information lead to poses and sums that are not finite.
template <LieGroup Group>
void OnlineMapOf<Group>::require_finite_chi2() {
  if (std::isfinite(graph_.chi2())) return;
  graph_.sum_again();  // an edge that has been removed since may have been the reason
  if (std::isfinite(graph_.chi2())) return;
  std::int32_t largest = -1;
  for (std::int32_t slot = 0; slot < graph_.edge_slots(); ++slot) {
    if (graph_.edge(slot).from < 0) continue;
    if (largest < 0 || !(graph_.edge(slot).chi2 <= graph_.edge(largest).chi2)) largest = slot;
    if (!std::isfinite(graph_.edge(slot).chi2)) break;
  }
  throw SingularAt(graph_.edge(largest).to);
}

// Makes the poses those that readers get, and returns the largest rotation among them.
template <LieGroup Group>
double OnlineMapOf<Group>::publish() {
  constexpr int kAngles = kDof == 3 ? 1 : 3;
  double turned = 0;
  // A component that is moved as a whole has not turned.
  std::vector<std::int32_t> carried;
  for (const auto& change : root_log_) carried.push_back(change.node);
  std::sort(carried.begin(), carried.end());
  const std::lock_guard<std::mutex> lock(mutex_);
  const std::int32_t before = state_.nodes;
  state_.nodes = graph_.size();
  for (std::int32_t i = before; i < state_.nodes; ++i) state_.points += points_[i];
  state_.poses.resize(std::size_t(state_.nodes) * kSize);
  for (const std::int32_t i : moved_) {
    double* const stored = state_.poses.data() + std::int64_t{i} * kSize;
    const Group& pose = graph_.place(i).pose;
    if (i < before && !std::binary_search(carried.begin(), carried.end(), i)) {
      const auto moved = error(Group{}, Group::load(stored), pose);
      turned = std::max(turned, moved.template tail<kAngles>().norm());
    }
    pose.store(stored);
  }
  state_.edges = graph_.edge_count();
  state_.chi2 = graph_.chi2();
  return kAngles == 1 ? turned : 2 * std::asin(std::min(turned, 1.0));
}

template <LieGroup Group>
void OnlineMapOf<Group>::roll_back() {
  pending_.clear();
  all_moved_ = false;
  for (auto e = removed_log_.rbegin(); e != removed_log_.rend(); ++e) {
    slot_of_[e->number] =
        graph_.add_edge(e->number, e->from, e->to, e->measured, e->information, e->sensor);
  }
  for (auto number = added_log_.rbegin(); number != added_log_.rend(); ++number) {
    graph_.remove_edge(slot_of_[*number]);
  }
  for (auto change = root_log_.rbegin(); change != root_log_.rend(); ++change) {
    graph_.node(change->node).root = change->root;
  }
  std::replace(slot_of_.begin(), slot_of_.end(), kWaiting, kRemoved);
  for (const std::int64_t number : added_log_) slot_of_[number] = kRemoved;
  const std::lock_guard<std::mutex> lock(mutex_);
  while (graph_.size() > state_.nodes) {
    index_.erase(ids_.back());
    ids_.pop_back();
    points_.pop_back();
    given_.pop_back();
    graph_.remove_last_node();
  }
  // The factor is left half made: it is made again at the last complete poses.
  factor_ = GrowingFactor<Group>();
  resize();
  for (std::int32_t i = 0; i < graph_.size(); ++i) {
    graph_.place(i).pose = Group::load(state_.poses.data() + std::int64_t{i} * kSize);
  }
  start_at_poses();
  // Covariances can be read before the next step.
  try {
    factor_.drop(graph_);
    factor_.eliminate(graph_);
    back_.weigh_newest(graph_, factor_);
  } catch (const SingularAt&) {
    factor_ = GrowingFactor<Group>();
    resize();
  }
  for (std::int32_t i = 0; i < graph_.size(); ++i) factor_.touch(i);
}

// Linearizes all edges at the current poses; the next step factorizes everything.
template <LieGroup Group>
void OnlineMapOf<Group>::start_at_poses() {
  for (std::int32_t i = 0; i < graph_.size(); ++i) {
    graph_.move_linearization(i);
    back_.know(graph_, i);
    factor_.touch(i);
  }
  for (std::int32_t slot = 0; slot < graph_.edge_slots(); ++slot) {
    if (graph_.edge(slot).from < 0) continue;
    graph_.linearize(slot);
    graph_.evaluate(slot);
  }
  graph_.sum_again();
}

}  // namespace masat
