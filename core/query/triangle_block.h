#pragma once

// Eight triangles in lanes, so that distances from one point to all of them are some operations on vectors. In
// floats: only where a walk goes depends on them, never the value of a sample.

#include <array>
#include <cstddef>
#include <cstdint>

#include "base/vector.h"

namespace barycast {

inline constexpr size_t kBlockLanes = 8;
using BlockLanes = std::array<float, kBlockLanes>;

// For distances, in forty operations: the point in every triangle's own frame, along its first edge, in its plane
// towards the third corner, off its plane, each a linear function of x, y, z and 1. Then the first edge's length, and
// directions in the plane and lengths of the edges from the second corner, and from the first, to the third.
struct alignas(64) DistanceBlock {
  enum Row { kAlong = 0, kInward = 4, kNormal = 8, kLength = 12, kSecond = 13, kThird = 16, kRows = 19 };
  std::array<BlockLanes, kRows> row;
  std::array<uint32_t, kBlockLanes> triangle;  // its number
};

// For lower bounds of them, in half as many: how far the point is off the plane, and outside of each edge's line in the
// plane; the distance but where a corner is nearest. What walks spend their time on.
struct alignas(64) BoundBlock {
  enum Row { kNormal = 0, kInside = 4, kRows = 16 };  // three edges
  std::array<BlockLanes, kRows> row;
  std::array<uint32_t, kBlockLanes> triangle;
};

// Put a triangle into a lane. One without area to speak of, or a segment (two corners the same), counts as its longest
// edge. Corners are in the normalized frame.
void set_lane(DistanceBlock& block, size_t lane, const std::array<Vec<3>, 3>& corners, uint32_t triangle);
// In the plane z = 0 (two dimensions) the bound of a segment is its distance; in space, that of its line.
void set_lane(BoundBlock& block, size_t lane, const std::array<Vec<3>, 3>& corners, uint32_t triangle, int dimension);

// What a distance or bound computed from a block is wrong by at most, for points within two diagonals of the origin:
// rounding of coordinates, and of the distance itself. Measured against doubles: 4e-7 and 4e-7.
inline constexpr float kBlockRounding = 1e-6f;
inline constexpr float kBlockRelativeRounding = 2e-6f;

}  // namespace barycast
