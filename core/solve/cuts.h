#pragma once

// Which elements of a surface others cut or come close to: where they do, what is known at some points of an element
// says little of those between.

#include <cstdint>
#include <vector>

#include "cage/cage.h"

namespace barycast {

// By element, 1 for those that an edge of another passes through, with both ends farther off than a tenth of the
// default thickness, for those that it belongs to, and for those that share a corner with either; but for edges that
// end on a corner of the element. Quads count as two flat triangles. Every edge is looked at with every element, some
// nanoseconds each, on the threads of the calling arena.
std::vector<uint8_t> cut_elements(const Cage<3>& cage);

// By element, 1 for those that leave a narrow gap: to an element that shares no corner with them, less than kGapMost
// and a part of their longest edge. Quads count as two flat triangles. The boxes of all pairs are looked at, some
// nanoseconds each, on the threads of the calling arena.
constexpr double kGapMost = 0.02;
std::vector<uint8_t> close_elements(const Cage<3>& cage);

}  // namespace barycast
