#include "query/triangle_block.h"

#include <algorithm>

namespace barycast {
namespace {

// Height over the longest edge below which a triangle has no inside that floats can see.
constexpr double kFlat = 1e-6;

void set_linear(TriangleBlock& block, size_t row, size_t lane, const Vec<3>& direction, const Vec<3>& origin) {
  for (size_t k = 0; k < 3; ++k) block.row[row + k][lane] = static_cast<float>(direction[static_cast<Eigen::Index>(k)]);
  block.row[row + 3][lane] = static_cast<float>(-direction.dot(origin));
}

void set_edge(TriangleBlock& block, size_t row, size_t lane, const Vec<2>& along) {
  const double length = along.norm();
  block.row[row][lane] = static_cast<float>(along[0] / length);
  block.row[row + 1][lane] = static_cast<float>(along[1] / length);
  block.row[row + 2][lane] = static_cast<float>(length);
}

}  // namespace

void set_lane(TriangleBlock& block, size_t lane, const std::array<Vec<3>, 3>& corners, uint32_t triangle) {
  // The longest edge comes first: the third corner then lies over it, and no direction is lost to rounding.
  size_t first = 0;
  for (size_t k = 1; k < 3; ++k)
    if ((corners[(k + 1) % 3] - corners[k]).norm() > (corners[(first + 1) % 3] - corners[first]).norm()) first = k;
  const Vec<3>&a = corners[first], &b = corners[(first + 1) % 3], &c = corners[(first + 2) % 3];
  const double length = (b - a).norm();
  const Vec<3> along = (b - a) / length;
  const Vec<3> area = along.cross(c - a);
  const double height = area.norm();
  const bool flat = height <= kFlat * length;
  const Vec<3> normal = flat ? along.unitOrthogonal() : Vec<3>(area / height);
  set_linear(block, TriangleBlock::kAlong, lane, along, a);
  set_linear(block, TriangleBlock::kInward, lane, normal.cross(along), a);
  set_linear(block, TriangleBlock::kNormal, lane, normal, a);
  block.row[TriangleBlock::kLength][lane] = static_cast<float>(length);
  // A flat triangle's third corner goes to the other side of the first edge, where nothing counts as inside.
  const Vec<2> third{std::clamp(along.dot(c - a), 0.0, length), flat ? -kFlat * length : height};
  set_edge(block, TriangleBlock::kSecond, lane, third - Vec<2>(length, 0.0));
  set_edge(block, TriangleBlock::kThird, lane, third);
  block.triangle[lane] = triangle;
}

}  // namespace barycast
