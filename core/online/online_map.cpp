#include "online/online_map.hpp"

namespace masat {

std::unique_ptr<OnlineMap> make_online_map(int dimension, double tolerance) {
  if (dimension == 2) return make_online_map_2d(tolerance);
  if (dimension == 3) return make_online_map_3d(tolerance);
  throw std::invalid_argument("the dimension must be 2 or 3");
}

}  // namespace masat
