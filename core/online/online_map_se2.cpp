#include "lie/se2.hpp"
#include "online/online_map.hpp"
#include "online/online_map_of.hpp"

namespace masat {

std::unique_ptr<OnlineMap> make_online_map_2d(double tolerance) {
  return std::make_unique<OnlineMapOf<SE2>>(tolerance);
}

}  // namespace masat
