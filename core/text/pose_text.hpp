// What the lines of each kind of pose hold.
#pragma once

#include "text/records.hpp"

namespace masat {

constexpr int dof_of(int dimension) { return dimension == 2 ? 3 : 6; }
constexpr bool is_position(PoseText pose) {
  return pose == PoseText::kXY || pose == PoseText::kXYZ;
}
constexpr int dimension_of(PoseText pose) {
  return pose == PoseText::kXYTheta || pose == PoseText::kXY ? 2 : 3;
}
constexpr int width_of(PoseText pose) {
  if (pose == PoseText::kMatrix) return 12;
  if (is_position(pose)) return dimension_of(pose);
  return pose == PoseText::kXYTheta ? 3 : pose == PoseText::kXYZRPY ? 6 : 7;
}
// Rows of the information that a line has.
constexpr int rows_of(PoseText pose) {
  return is_position(pose) ? dimension_of(pose) : dof_of(dimension_of(pose));
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
    default:
      return "x y z qx qy qz qw";
  }
}

}  // namespace masat
