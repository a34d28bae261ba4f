#include "query/triangle_block.h"

#include <algorithm>

namespace barycast {
namespace {

// Height over the longest edge below which a triangle has no inside that floats can see.
constexpr double kFlat = 1e-6;
// Of a linear function that is to be inside everywhere.
constexpr double kFarInside = 1e6;

// Directions and lengths of a triangle about its longest edge: the third corner lies over that edge, and no direction
// is lost to rounding.
struct Frame {
  Vec<3> origin, along, inward, normal;
  double length;
  Vec<2> third;  // corner, along and inward
  bool flat;
};

Frame frame_of(const std::array<Vec<3>, 3>& corners) {
  size_t first = 0;
  for (size_t k = 1; k < 3; ++k)
    if ((corners[(k + 1) % 3] - corners[k]).norm() > (corners[(first + 1) % 3] - corners[first]).norm()) first = k;
  const Vec<3>&a = corners[first], &b = corners[(first + 1) % 3], &c = corners[(first + 2) % 3];
  Frame frame;
  frame.origin = a;
  frame.length = (b - a).norm();
  frame.along = (b - a) / frame.length;
  const Vec<3> area = frame.along.cross(c - a);
  const double height = area.norm();
  frame.flat = height <= kFlat * frame.length;
  // Flat ones in the plane z = 0 get a normal within it.
  frame.normal =
      frame.flat ? frame.along.cross(std::abs(frame.along[2]) < 0.7 ? Vec<3>::UnitZ() : Vec<3>::UnitX()).normalized()
                 : Vec<3>(area / height);
  frame.inward = frame.normal.cross(frame.along);
  frame.third = {std::clamp(frame.along.dot(c - a), 0.0, frame.length), height};
  return frame;
}

// row[r .. r + 3] . (x, y, z, 1) = direction . (p - origin).
template <class Block>
void set_linear(Block& block, size_t row, size_t lane, const Vec<3>& direction, const Vec<3>& origin) {
  for (size_t k = 0; k < 3; ++k) block.row[row + k][lane] = static_cast<float>(direction[static_cast<Eigen::Index>(k)]);
  block.row[row + 3][lane] = static_cast<float>(-direction.dot(origin));
}

void set_edge(DistanceBlock& block, size_t row, size_t lane, const Vec<2>& along) {
  const double length = along.norm();
  block.row[row][lane] = static_cast<float>(along[0] / length);
  block.row[row + 1][lane] = static_cast<float>(along[1] / length);
  block.row[row + 2][lane] = static_cast<float>(length);
}

}  // namespace

void set_lane(DistanceBlock& block, size_t lane, const std::array<Vec<3>, 3>& corners, uint32_t triangle) {
  const Frame frame = frame_of(corners);
  set_linear(block, DistanceBlock::kAlong, lane, frame.along, frame.origin);
  set_linear(block, DistanceBlock::kInward, lane, frame.inward, frame.origin);
  set_linear(block, DistanceBlock::kNormal, lane, frame.normal, frame.origin);
  block.row[DistanceBlock::kLength][lane] = static_cast<float>(frame.length);
  // A flat triangle's third corner goes to the other side of the first edge, where nothing counts as inside.
  const Vec<2> third = frame.flat ? Vec<2>(frame.third[0], -kFlat * frame.length) : frame.third;
  set_edge(block, DistanceBlock::kSecond, lane, third - Vec<2>(frame.length, 0.0));
  set_edge(block, DistanceBlock::kThird, lane, third);
  block.triangle[lane] = triangle;
}

void set_lane(BoundBlock& block, size_t lane, const std::array<Vec<3>, 3>& corners, uint32_t triangle, int dimension) {
  const Frame frame = frame_of(corners);
  block.triangle[lane] = triangle;
  set_linear(block, BoundBlock::kNormal, lane, frame.normal, frame.origin);
  const auto set_inside = [&](size_t edge, const Vec<3>& inward, const Vec<3>& origin) {
    set_linear(block, BoundBlock::kInside + 4 * edge, lane, inward, origin);
  };
  const Vec<3> second = frame.origin + frame.length * frame.along;
  if (frame.flat) {
    const bool in_plane = dimension == 2;
    set_inside(0, in_plane ? frame.along : frame.inward, frame.origin);
    set_inside(1, in_plane ? Vec<3>(-frame.along) : Vec<3>(-frame.inward), in_plane ? second : frame.origin);
    set_inside(2, Vec<3>::Zero(), Vec<3>::Zero());
    block.row[BoundBlock::kInside + 11][lane] = static_cast<float>(kFarInside);
    return;
  }
  set_inside(0, frame.inward, frame.origin);
  const auto across = [&](const Vec<2>& edge) {  // its normal on the left
    return Vec<3>((edge[0] * frame.inward - edge[1] * frame.along).normalized());
  };
  set_inside(1, across(frame.third - Vec<2>(frame.length, 0.0)), second);
  set_inside(2, -across(frame.third), frame.origin);
}

}  // namespace barycast
