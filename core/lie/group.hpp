#pragma once

#include "lie/se2.hpp"
#include "lie/se3.hpp"

namespace masat {

template <class G>
concept LieGroup = true;

}  // namespace masat
