// Pose graphs as text, line by line: a format is a table of records, one for each tag.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace masat {

// Comments at the end of a line: "# label: NAME" of an edge, "# stamp: TIME" of a vertex.
inline constexpr std::string_view kLabel = "label", kStamp = "stamp";

enum class Kind {
  kVertex,
  kEdge,
  kFix,
  kPose,         // a vertex without an id
  kStampedPose,  // one whose line begins with its stamp
  kPrior,        // an edge from the world
  kPoint,        // a vertex that is a landmark
  kObservation,  // an edge from a pose to a landmark
  kParameter,    // the pose of a sensor on the robot
};

enum class PoseText {
  kXYTheta,                // x y theta
  kXYZQuat,                // x y z qx qy qz qw
  kXYZRPY,                 // x y z roll pitch yaw; the information refers to these angles
  kMatrix,                 // the upper three rows of the 4x4 matrix, row by row
  kXY,                     // x y: a position
  kXYZ,                    // x y z
  kBearing,                // the angle to a landmark in 2D
  kRangeBearing,           // and its distance before it
  kRangeBearingElevation,  // the same in 3D
};

enum class InformationText {
  kUpper,       // upper triangle, row by row
  kToroPlanar,  // xx xy yy tt xt yt
  kSquareRoot,  // upper triangular R, row by row; the information is R'R
  kCovariance,  // full covariance, row by row
};

struct Record {
  std::string tag;  // empty if the lines begin with a number
  Kind kind;
  PoseText pose;
  InformationText information;
  bool information_optional;
  bool parameter;  // whether the id of a parameter follows those of the vertices
};

struct ParseError : std::runtime_error {
  ParseError(std::int64_t line_number, const std::string& what)
      : std::runtime_error(what), line(line_number) {}
  std::int64_t line;
};

struct UnknownTag {
  std::string tag;
  std::int64_t count, first_line;
};

// The contents of a text as flat arrays; `*_lines` are line numbers, from 1.
struct ParsedGraph {
  int dimension = 0;  // 0 if the text has neither a vertex nor an edge
  std::vector<std::int64_t> vertex_ids, vertex_lines;
  std::vector<double> vertex_poses;
  std::vector<std::string> vertex_stamps;  // empty if no vertex has one; "" for a vertex without
  std::vector<std::int64_t> edge_ids, edge_lines;  // (from, to) pairs
  std::vector<double> measurements, information;
  std::vector<std::string> edge_labels;  // empty if no edge has one; "" for an edge without
  // Poses and information of poses; of positions the rotation is the identity, without information.
  std::vector<std::int64_t> prior_ids, prior_lines, prior_parameters;  // parameter -1: none
  std::vector<double> priors, prior_information;
  std::vector<std::int64_t> point_ids, point_lines;
  std::vector<double> points;
  std::vector<std::int64_t> observation_ids, observation_lines, observation_parameters;
  // Positions, or where `observation_range_bearing` is 1: range, bearing and in 3D elevation.
  std::vector<double> observations, observation_information;
  std::vector<std::uint8_t> observation_range_bearing;
  std::vector<std::int64_t> parameter_ids, parameter_lines;
  std::vector<double> parameters;
  std::vector<std::int64_t> fixed_ids, fixed_lines;
  std::vector<UnknownTag> unknown;
  std::int64_t edges_without_information = 0;
};

// Throws ParseError.
ParsedGraph parse(std::string_view text, const std::vector<Record>& records);

// Counts the lines that begin with each tag; lines that begin with a number are "N columns".
std::vector<std::pair<std::string, std::int64_t>> count_tags(std::string_view text);

// Returns one line for each row: tag, integers, the shortest decimals that read back as the same
// doubles, and the comment "# NAME: LABEL", unless `labels` is empty.
std::string format_lines(std::string_view tag, const std::int64_t* integers,
                         std::int64_t integer_columns, const double* values,
                         std::int64_t value_columns, std::int64_t rows,
                         const std::vector<std::string>& labels, std::string_view name);

}  // namespace masat
