#pragma once

// Which elements lines through one point may meet: all of them tested at once, in vectors of the processor's width.
// In floats, with a margin for what rounding may move: they propose, and line_hits.h decides.
//
// Seen from the point, an edge from a to b spans a plane with the normal a x b, and a line passes it on the side that
// its direction has. It meets a triangle if it passes all three edges on the same side, forwards or backwards; and a
// bilinear patch only if it meets one of the four triangles of its corners, whose hull the patch lies in.

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

// The same from one point: the normals of the planes of three edges, or of a quad's four and both diagonals; and what
// the product of one of them with a direction may be off by.
struct alignas(64) PencilBlock {
  std::array<std::array<SweepLanes, 3>, 6> normal;
  SweepLanes margin;
};

// For points within two diagonals of the origin.
void prepare_pencil(const SweepBlock& block, const std::array<float, 3>& point, PencilBlock& out);

// A bit for every element that the line with this direction, of unit length, may meet.
uint32_t may_meet(const SweepBlock& block, const PencilBlock& pencil, const std::array<float, 3>& direction);

}  // namespace barycast
