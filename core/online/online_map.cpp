#include "online/online_map.hpp"

#include "online/online_map_of.hpp"

namespace masat {

std::unique_ptr<OnlineMap> make_online_map(int dimension, double tolerance) {
  if (dimension == 2) return std::make_unique<OnlineMapOf<SE2>>(tolerance);
  if (dimension == 3) return std::make_unique<OnlineMapOf<SE3>>(tolerance);
  throw std::invalid_argument("the dimension must be 2 or 3");
}

}  // namespace masat
