#pragma once

// Eight triangles in lanes, each in a frame of its own, so that the distance from one point to all of them is forty
// operations on vectors: what walks spend their time on. In floats: only where a walk goes depends on them, never the
// value of a sample.

#include <array>
#include <cstddef>
#include <cstdint>

#include "base/vector.h"

namespace barycast {

inline constexpr size_t kBlockLanes = 8;

struct alignas(64) TriangleBlock {
  using Lanes = std::array<float, kBlockLanes>;
  // The point in the triangle's frame: along its first edge, in its plane towards the third corner, off its plane; each
  // a linear function of x, y, z and 1. Then the first edge's length, and directions in the plane and lengths of the
  // edges from the second corner, and from the first, to the third.
  enum Row { kAlong = 0, kInward = 4, kNormal = 8, kLength = 12, kSecond = 13, kThird = 16, kRows = 19 };
  std::array<Lanes, kRows> row;
  std::array<uint32_t, kBlockLanes> triangle;  // its number
};

// Puts a triangle into a lane. One without area to speak of, or a segment (two corners the same), counts as its longest
// edge. Corners are in the normalized frame.
void set_lane(TriangleBlock& block, size_t lane, const std::array<Vec<3>, 3>& corners, uint32_t triangle);

// What a distance computed from a block is wrong by at most, for points within two diagonals of the origin: rounding
// of coordinates, and of the distance itself. Measured against doubles: 4e-7 and 4e-7.
inline constexpr float kBlockRounding = 1e-6f;
inline constexpr float kBlockRelativeRounding = 2e-6f;

}  // namespace barycast
