// The contents of a map as a whole. Included by online_map_of.hpp alone.
#pragma once

namespace masat {

template <LieGroup Group>
void OnlineMapOf<Group>::set_poses(const double* poses) {
  for (std::int32_t i = 0; i < state_.nodes; ++i) {
    graph_.place(i).pose = Group::load(poses + std::int64_t{i} * kSize);
  }
  start_at_poses();
  try {
    factor_.drop(graph_);
    factor_.eliminate(graph_);
  } catch (const SingularAt& at) {
    root_log_.clear();
    removed_log_.clear();
    added_log_.clear();
    const std::int64_t id = ids_[at.node];
    roll_back();
    throw Undetermined(id);
  }
  publish_all();
}

template <LieGroup Group>
void OnlineMapOf<Group>::publish_all() {
  moved_.clear();
  for (std::int32_t i = 0; i < graph_.size(); ++i) moved_.push_back(i);
  publish();
}

template <LieGroup Group>
double OnlineMapOf<Group>::exact_chi2() const {
  double sum = 0;
  for (std::int32_t slot = 0; slot < graph_.edge_slots(); ++slot) {
    const auto& e = graph_.edge(slot);
    if (e.from < 0) continue;
    const auto now = error(e.measured, graph_.place(e.from).pose, graph_.place(e.to).pose);
    sum += now.dot(e.information * now);
  }
  return sum;
}

template <LieGroup Group>
MapContents OnlineMapOf<Group>::contents() const {
  MapContents out;
  out.ids.assign(ids_.begin(), ids_.begin() + state_.nodes);
  out.poses = state_.poses;
  out.bases.resize(state_.poses.size());
  for (std::int32_t i = 0; i < state_.nodes; ++i) {
    out.roots.push_back(graph_.node(i).root);
    graph_.place(i).linearized.store(out.bases.data() + std::int64_t{i} * kSize);
  }
  out.next_edge = next_edge();
  for (std::int64_t number = 0; number < next_edge(); ++number) {
    if (slot_of_[number] < 0) continue;
    const auto& e = graph_.edge(slot_of_[number]);
    out.numbers.push_back(number);
    out.pairs.push_back(ids_[e.from]);
    out.pairs.push_back(ids_[e.to]);
    out.measurements.resize(out.measurements.size() + kSize);
    e.measured.store(out.measurements.data() + out.measurements.size() - kSize);
    out.information.insert(out.information.end(), e.information.data(),
                           e.information.data() + kDof * kDof);
  }
  return out;
}

template <LieGroup Group>
void OnlineMapOf<Group>::fill(const MapContents& contents) {
  const auto count = static_cast<std::int32_t>(contents.ids.size());
  for (std::int32_t i = 0; i < count; ++i) {
    const double* const base = contents.bases.data() + std::int64_t{i} * kSize;
    if (!add_node(contents.ids[i], base)) throw std::invalid_argument("a pose of the map");
    const Group pose = Group::load(contents.poses.data() + std::int64_t{i} * kSize);
    graph_.step(i) = error(Group{}, graph_.place(i).linearized, pose);
    graph_.place(i).pose = pose;
    graph_.node(i).root = contents.roots[i];
  }
  resize();
  slot_of_.assign(contents.next_edge, kRemoved);
  for (std::size_t k = 0; k < contents.numbers.size(); ++k) {
    const std::int32_t from = find(contents.pairs[2 * k]), to = find(contents.pairs[2 * k + 1]);
    const Eigen::Map<const Square> w(contents.information.data() + k * kDof * kDof);
    slot_of_[contents.numbers[k]] = graph_.add_edge(
        contents.numbers[k], from, to, Group::load(contents.measurements.data() + k * kSize), w);
  }
  for (std::int32_t i = 0; i < count; ++i) {
    back_.know(graph_, i);
    factor_.touch(i);
  }
  try {
    factor_.drop(graph_);
    factor_.eliminate(graph_);
  } catch (const SingularAt& at) {
    throw Undetermined(ids_[at.node]);
  }
  publish_all();
}

}  // namespace masat
