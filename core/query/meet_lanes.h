#pragma once

// Where lines meet triangles and bilinear patches, in vectors of doubles, a candidate in every lane (AVX2 or AVX-512,
// chosen when the program runs; the same bits for both, for a lane never sees its neighbours). What line_hits.h says
// of hits is decided here.

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "cage/cage.h"
#include "query/line_hits.h"

namespace barycast {

// The corners of elements as vector code reads them: x, y, z and nothing of each. Of a triangle three.
struct alignas(64) ElementCorners {
  std::array<double, 16> coordinate;
};
ElementCorners corners_of(const Cage<3>& cage, const Element& element);
// Of all elements.
std::vector<ElementCorners> corners_of(const Cage<3>& cage);

// Appends the hits of candidates, which are all quads or all triangles, with t > from: candidate by candidate, two of
// one patch in the order of its roots. `corners` are of all elements that candidates name.
void meet_candidates(std::span<const ElementCorners> corners, bool quads, const Vec<3>& origin,
                     std::span<const Vec<3>> directions, std::span<const LineCandidate> candidates, double from,
                     std::vector<LineHit<3>>& hits);

}  // namespace barycast
