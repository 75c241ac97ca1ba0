// The contents of a map as a whole. Included by online_map_of.hpp alone.
#pragma once

namespace masat {

template <LieGroup Group>
void OnlineMapOf<Group>::set_poses(const double* poses) {
  load_poses(poses);
  try {
    factor_.drop(graph_);
    factor_.eliminate(graph_);
    back_.weigh_newest(graph_, factor_);
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
void OnlineMapOf<Group>::start_from(const double* poses) {
  load_poses(poses);
  all_moved_ = true;
}

template <LieGroup Group>
void OnlineMapOf<Group>::load_poses(const double* poses) {
  for (std::int32_t i = 1; i < state_.nodes; ++i) {
    graph_.place(i).pose = Group::load(poses + (std::int64_t{i} - 1) * kSize);
  }
  start_at_poses();
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
void OnlineMapOf<Group>::predict(std::span<const std::int32_t> ends, const double* measurements,
                                 const double* information, double* distances,
                                 double* log_determinants) {
  constexpr std::int64_t kArea = std::int64_t{kDof} * kDof;
  const std::size_t count = ends.size() / 2;
  std::vector<std::int32_t> rows, columns;
  for (std::size_t k = 0; k < count; ++k) {
    const std::int32_t a = ends[2 * k], b = ends[2 * k + 1];
    rows.insert(rows.end(), {a, b, b});
    columns.insert(columns.end(), {a, b, a});
  }
  std::vector<double> blocks(rows.size() * kArea);
  covariance_.write(factor_, rows, columns, blocks.data());
  for (std::size_t k = 0; k < count; ++k) {
    const std::int32_t a = ends[2 * k], b = ends[2 * k + 1];
    if (graph_.node(a).root != graph_.node(b).root) {
      distances[k] = log_determinants[k] = std::numeric_limits<double>::quiet_NaN();
      continue;
    }
    const Group measured = Group::load(measurements + k * kSize);
    Square by_a, by_b;
    error(measured, graph_.place(a).linearized, graph_.place(b).linearized, by_a, by_b);
    const double* const block = blocks.data() + 3 * k * kArea;
    // A row-major block is the transpose of what Eigen reads.
    const Eigen::Map<const Square> of_a(block), of_b(block + kArea), joint(block + 2 * kArea);
    const Square mixed = by_a * joint * by_b.transpose();
    const Square noise = Eigen::Map<const Square>(information + k * kArea).inverse();
    const Square total = by_a * of_a * by_a.transpose() + by_b * of_b * by_b.transpose() + mixed +
                         mixed.transpose() + noise;
    const Eigen::LLT<Square> root(total);
    const Tangent e = error(measured, graph_.place(a).pose, graph_.place(b).pose);
    distances[k] = root.matrixL().solve(e).squaredNorm();
    log_determinants[k] = kDof * std::log(2 * std::numbers::pi);
    for (int i = 0; i < kDof; ++i) log_determinants[k] += 2 * std::log(root.matrixLLT()(i, i));
  }
}

template <LieGroup Group>
MapContents OnlineMapOf<Group>::contents() const {
  MapContents out;
  out.ids.assign(ids_.begin() + 1, ids_.begin() + state_.nodes);
  out.poses.assign(state_.poses.begin() + kSize, state_.poses.end());
  out.bases.resize(out.poses.size());
  for (std::int32_t i = 1; i < state_.nodes; ++i) {
    out.roots.push_back(graph_.node(i).root - 1);
    graph_.place(i).linearized.store(out.bases.data() + (std::int64_t{i} - 1) * kSize);
  }
  out.next_edge = next_edge();
  for (std::int64_t number = 0; number < next_edge(); ++number) {
    if (slot_of_[number] < 0) continue;
    const auto& e = graph_.edge(slot_of_[number]);
    const bool prior = e.from == 0;
    auto& measurements = prior ? out.prior_measurements : out.measurements;
    auto& information = prior ? out.prior_information : out.information;
    (prior ? out.prior_numbers : out.numbers).push_back(number);
    if (prior) {
      out.prior_ids.push_back(ids_[e.to]);
    } else {
      out.pairs.push_back(ids_[e.from]);
      out.pairs.push_back(ids_[e.to]);
    }
    measurements.resize(measurements.size() + kSize);
    e.measured.store(measurements.data() + measurements.size() - kSize);
    information.insert(information.end(), e.information.data(), e.information.data() + kDof * kDof);
  }
  return out;
}

template <LieGroup Group>
void OnlineMapOf<Group>::fill(const MapContents& contents) {
  const auto count = static_cast<std::int32_t>(contents.ids.size());
  for (std::int32_t k = 0; k < count; ++k) {
    const double* const base = contents.bases.data() + std::int64_t{k} * kSize;
    if (!add_node(contents.ids[k], base)) throw std::invalid_argument("a pose of the map");
    const std::int32_t i = k + 1;
    const Group pose = Group::load(contents.poses.data() + std::int64_t{k} * kSize);
    graph_.step(i) = error(Group{}, graph_.place(i).linearized, pose);
    graph_.place(i).pose = pose;
    graph_.node(i).root = contents.roots[k] + 1;
  }
  resize();
  slot_of_.assign(contents.next_edge, kRemoved);
  const auto add = [this](std::int64_t number, std::int32_t from, std::int32_t to,
                          const double* measured, const double* information) {
    slot_of_[number] = graph_.add_edge(number, from, to, Group::load(measured),
                                       Eigen::Map<const Square>(information));
  };
  constexpr std::size_t kArea = kDof * kDof;
  for (std::size_t k = 0; k < contents.numbers.size(); ++k) {
    add(contents.numbers[k], find(contents.pairs[2 * k]), find(contents.pairs[2 * k + 1]),
        contents.measurements.data() + k * kSize, contents.information.data() + k * kArea);
  }
  for (std::size_t k = 0; k < contents.prior_numbers.size(); ++k) {
    add(contents.prior_numbers[k], 0, find(contents.prior_ids[k]),
        contents.prior_measurements.data() + k * kSize,
        contents.prior_information.data() + k * kArea);
  }
  for (std::int32_t i = 0; i <= count; ++i) {
    back_.know(graph_, i);
    factor_.touch(i);
  }
  try {
    factor_.drop(graph_);
    factor_.eliminate(graph_);
    back_.weigh_newest(graph_, factor_);
  } catch (const SingularAt& at) {
    throw Undetermined(ids_[at.node]);
  }
  publish_all();
}

}  // namespace masat
