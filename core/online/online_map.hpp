// A map that grows: what the bindings see of it, whatever the group.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <stdexcept>
#include <vector>

namespace masat {

// The edges do not determine a node's pose. The map is as it was before the update.
struct Undetermined : std::runtime_error {
  explicit Undetermined(std::int64_t i) : runtime_error("undetermined pose"), id(i) {}
  std::int64_t id;
};

// Priors, which are edges from the world, and observations of points, one a row.
struct SensorEdges {
  std::vector<std::int64_t> numbers;
  std::vector<std::int32_t> ends;  // indices of nodes, two a row
  std::vector<double> measurements, information;
  std::vector<double> offsets;              // of the sensors on the nodes that they lead to
  std::vector<std::uint8_t> range_bearing;  // 1 where range and bearing were measured
};

// All of a map: what a file holds of it. The world is not among the nodes; its index is -1.
struct MapContents {
  std::vector<std::int64_t> ids;      // of the nodes, in the order in which they were added
  std::vector<std::uint8_t> points;   // 1 for those that are points
  std::vector<double> poses, bases;   // where they are, and where their edges were linearized
  std::vector<std::int32_t> roots;    // the fixed node of each one's component; -1: the world
  std::vector<std::int64_t> numbers;  // of the edges, ascending
  std::vector<std::int64_t> pairs;    // ids that the edges join
  std::vector<double> measurements, information;
  SensorEdges sensor_edges;
  std::int64_t next_edge = 0;
};

struct StepSummary {
  double chi2 = 0;
  std::int64_t refactored = 0, relinearized = 0, changed = 0;  // nodes
  std::int32_t passes = 0;
  bool complete = true;  // whether the tolerance has been reached
  // Largest rotation in radians, but for nodes that are new or have another fixed node now.
  double turned = 0;
};

// The world is the node of index 0: it is fixed at the identity, and priors are edges from it.
class OnlineMap {
 public:
  virtual ~OnlineMap() = default;
  virtual int dof() const = 0;
  virtual int pose_size() const = 0;

  // What is added or removed waits for the next update. A node that has its pose from the caller
  // starts there; others are placed by their first edge. Returns false, without any change, if
  // something needs a closer look: unknown ids, numbers that are not finite, information that is
  // not symmetric positive definite, quaternions that are not of unit length. Edges get the next
  // numbers, or those of removed edges, if `numbers` are given. An edge that is removed before it
  // was part of the map never will be.
  virtual bool add_node(std::int64_t id, const double* pose, bool is_point) = 0;
  virtual bool add_edges(std::span<const std::int64_t> pairs, const double* measurements,
                         const double* information, const std::int64_t* numbers) = 0;
  // The same for priors and observations; information may be semidefinite, which is not checked. An
  // edge that would join two components is left out, unless one is a point that nothing measures
  // and the edge may place it. If `may_place` is empty, edges may join components, which stay where
  // they are. New numbers if `edges` has none.
  virtual bool add_sensor_edges(const SensorEdges& edges, std::span<const bool> may_place) = 0;
  // The numbers of the edges that the last update has left out.
  virtual std::vector<std::int64_t> left_out() const = 0;
  virtual bool has_sensor_edges() const = 0;
  virtual bool is_point(std::int32_t node) const = 0;
  // Moves a point that nothing measures.
  virtual void place_point(std::int32_t node, const double* pose) = 0;
  virtual bool remove_edges(std::span<const std::int64_t> numbers) = 0;
  virtual bool has_edge(std::int64_t number) const = 0;
  virtual std::int64_t next_edge() const = 0;  // the number of the next edge that is added
  virtual std::int32_t find(
      std::int64_t id) const = 0;  // the index of a node, waiting or not; or -1

  // Applies what waits and solves. After `budget` seconds no further nodes are linearized again;
  // the next update goes on. Throws Undetermined, and forgets what waited.
  virtual StepSummary update(double budget) = 0;

  // Moves all nodes but the world to other poses, and linearizes there. Throws Undetermined.
  virtual void set_poses(const double* poses) = 0;
  // Makes the next update solve everything, from other poses. They are forgotten if it throws.
  virtual void start_from(const double* poses) = 0;
  // The sum over the edges at the current poses; what `update` tells is approximate.
  virtual double exact_chi2() const = 0;
  // Blocks of the joint covariance of the steps from the linearization, by indices of nodes; each
  // row-major, zero for fixed nodes.
  virtual void covariances(std::span<const std::int32_t> rows,
                           std::span<const std::int32_t> columns, double* out) = 0;
  virtual void linearized(std::span<const std::int32_t> nodes, double* out) const = 0;
  // What the map says of edges that are not part of it, by the indices of their ends: the squared
  // Mahalanobis distance of the measurement from its prediction, with the covariances of both, and
  // log det 2 pi of their sum. NaN between components.
  virtual void predict(std::span<const std::int32_t> ends, const double* measurements,
                       const double* information, double* distances, double* log_determinants) = 0;
  // chi2 of edges of the map by their numbers, as of their last evaluation.
  virtual void edge_chi2(std::span<const std::int64_t> numbers, double* out) const = 0;
  virtual std::vector<std::int32_t> roots() const = 0;  // the fixed node of each one's component
  virtual MapContents contents() const = 0;
  // Fills an empty map, whose numbers have been checked. Throws Undetermined.
  virtual void fill(const MapContents& contents) = 0;
  virtual std::int64_t bytes_of_factor() const = 0;
  virtual std::int64_t fill_of_factor() const = 0;  // scalars

  // The last complete state, the world included, which any thread may read at any time.
  virtual std::int32_t nodes() const = 0;
  virtual std::int32_t point_count() const = 0;
  virtual std::vector<std::uint8_t> points() const = 0;  // 1 for nodes that are points
  virtual std::int64_t edges() const = 0;
  virtual std::vector<std::int64_t> ids() const = 0;
  virtual double chi2() const = 0;
  virtual std::vector<double> poses() const = 0;
  virtual bool pose(std::int32_t node, double* out) const = 0;
};

std::unique_ptr<OnlineMap> make_online_map(int dimension, double tolerance);
// Each is in a file of its own, so that both are compiled at the same time.
std::unique_ptr<OnlineMap> make_online_map_2d(double tolerance);
std::unique_ptr<OnlineMap> make_online_map_3d(double tolerance);

}  // namespace masat
