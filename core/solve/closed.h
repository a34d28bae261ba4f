#pragma once

#include "cage/cage.h"

namespace barycast {

// Whether the elements bound a volume and face one way: every edge is used as often in one direction as in the
// other, vertices at equal positions being one. Parts may be separate or intersect.
bool is_closed(const Cage<3>& cage);

}  // namespace barycast
