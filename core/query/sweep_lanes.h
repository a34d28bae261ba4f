#pragma once

// Which elements lines through one point may meet: all of them tested at once, in vectors of the processor's width.
// In floats, with a margin for what rounding may move: they propose, and line_hits.h decides.
//
// Seen from the point, an edge from a to b spans a plane with the normal a x b, and a line passes it on the side that
// its direction has. It meets a triangle if it passes all three edges on the same side, forwards or backwards; and a
// bilinear patch only if it meets one of the four triangles of its corners, whose hull the patch lies in. Three of them
// will do: what lies in the hull is covered twice.

#include <array>
#include <cstddef>
#include <cstdint>

namespace barycast {

inline constexpr size_t kSweepLanes = 16;
using SweepLanes = std::array<float, kSweepLanes>;

// Elements in lanes, all triangles or all quads. Empty lanes repeat the first.
struct alignas(64) SweepBlock {
  std::array<std::array<SweepLanes, 3>, 4> corner;  // x, y, z of each; of a triangle three
  std::array<uint32_t, kSweepLanes> element;
  uint32_t count;
  bool quads;
};

// Directions of lines, of unit length, an array for each coordinate.
struct SweepDirections {
  const float *x, *y, *z;
  size_t count;
};

// Of every line through the point, which lies within two diagonals of the origin, a bit for every element that it may
// meet.
void sweep_lines(const SweepBlock& block, const std::array<float, 3>& point, const SweepDirections& directions,
                 uint16_t* may_meet);

}  // namespace barycast
