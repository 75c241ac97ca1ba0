// What the lines of each kind of pose hold.
#pragma once

#include "text/records.hpp"

namespace masat {

constexpr int dof_of(int dimension) { return dimension == 2 ? 3 : 6; }
constexpr bool is_position(PoseText pose) {
  return pose == PoseText::kXY || pose == PoseText::kXYZ;
}
constexpr bool is_range_bearing(PoseText pose) {
  return pose == PoseText::kBearing || pose == PoseText::kRangeBearing ||
         pose == PoseText::kRangeBearingElevation;
}
constexpr int dimension_of(PoseText pose) {
  switch (pose) {
    case PoseText::kXYTheta:
    case PoseText::kXY:
    case PoseText::kBearing:
    case PoseText::kRangeBearing:
      return 2;
    default:
      return 3;
  }
}
constexpr int width_of(PoseText pose) {
  if (pose == PoseText::kMatrix) return 12;
  if (pose == PoseText::kBearing) return 1;
  if (is_position(pose) || is_range_bearing(pose)) return dimension_of(pose);
  return pose == PoseText::kXYTheta ? 3 : pose == PoseText::kXYZRPY ? 6 : 7;
}
// Rows of the information that a line has.
constexpr int rows_of(PoseText pose) {
  return is_position(pose) || is_range_bearing(pose) ? width_of(pose) : dof_of(dimension_of(pose));
}
constexpr const char* words_of(PoseText pose) {
  switch (pose) {
    case PoseText::kXYTheta:
      return "x y theta";
    case PoseText::kXYZRPY:
      return "x y z roll pitch yaw";
    case PoseText::kMatrix:
      return "the upper three rows of a 4x4 matrix, row by row";
    case PoseText::kXY:
      return "x y";
    case PoseText::kXYZ:
      return "x y z";
    case PoseText::kBearing:
      return "bearing";
    case PoseText::kRangeBearing:
      return "range bearing";
    case PoseText::kRangeBearingElevation:
      return "range bearing elevation";
    default:
      return "x y z qx qy qz qw";
  }
}

}  // namespace masat
