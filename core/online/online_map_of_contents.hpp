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
    const auto now = graph_.residual(slot);
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
    out.points.push_back(graph_.node(i).is_point);
    graph_.place(i).linearized.store(out.bases.data() + (std::int64_t{i} - 1) * kSize);
  }
  out.next_edge = next_edge();
  for (std::int64_t number = 0; number < next_edge(); ++number) {
    if (slot_of_[number] < 0) continue;
    const auto& e = graph_.edge(slot_of_[number]);
    auto& others = out.sensor_edges;
    const bool is_other = e.from == 0 || graph_.node(e.to).is_point;
    auto& measurements = is_other ? others.measurements : out.measurements;
    auto& information = is_other ? others.information : out.information;
    (is_other ? others.numbers : out.numbers).push_back(number);
    if (is_other) {
      const Sensor<Group> sensor = graph_.sensor(slot_of_[number]);
      others.ends.insert(others.ends.end(), {e.from - 1, e.to - 1});
      others.range_bearing.push_back(sensor.range_bearing);
      others.offsets.resize(others.offsets.size() + kSize);
      sensor.offset.store(others.offsets.data() + others.offsets.size() - kSize);
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
    if (!add_node(contents.ids[k], base, contents.points[k] != 0))
      throw std::invalid_argument("a pose of the map");
    const std::int32_t i = k + 1;
    const Group pose = Group::load(contents.poses.data() + std::int64_t{k} * kSize);
    graph_.step(i) = error(Group{}, graph_.place(i).linearized, pose);
    graph_.place(i).pose = pose;
    graph_.node(i).root = contents.roots[k] + 1;
  }
  resize();
  slot_of_.assign(contents.next_edge, kRemoved);
  const auto add = [this](std::int64_t number, std::int32_t from, std::int32_t to,
                          const double* measured, const double* information,
                          const Sensor<Group>& sensor) {
    slot_of_[number] = graph_.add_edge(number, from, to, Group::load(measured),
                                       Eigen::Map<const Square>(information), sensor);
  };
  constexpr std::size_t kArea = kDof * kDof;
  for (std::size_t k = 0; k < contents.numbers.size(); ++k) {
    add(contents.numbers[k], find(contents.pairs[2 * k]), find(contents.pairs[2 * k + 1]),
        contents.measurements.data() + k * kSize, contents.information.data() + k * kArea, {});
  }
  const SensorEdges& others = contents.sensor_edges;
  for (std::size_t k = 0; k < others.numbers.size(); ++k) {
    add(others.numbers[k], others.ends[2 * k] + 1, others.ends[2 * k + 1] + 1,
        others.measurements.data() + k * kSize, others.information.data() + k * kArea,
        sensor_of<Group>(others, k));
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
