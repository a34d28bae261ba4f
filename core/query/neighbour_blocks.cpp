#include "query/neighbour_blocks.h"

#include <algorithm>

namespace barycast {
namespace {

class Cutter {
 public:
  Cutter(const FacetLevels& facets, NeighbourBlocks& out) : facets_(facets), out_(out) {
    middles_.reserve(facets.triangles.size());
    for (const FacetTriangle& triangle : facets.triangles) {
      const auto& corners = triangle.corners;
      middles_.push_back((corners[0] + corners[1] + corners[2]) / 3);
    }
  }

  // Neighbours, by cutting at medians.
  void cut(uint32_t* begin, uint32_t* end) {
    const auto count = static_cast<size_t>(end - begin);
    if (count <= kBlockLanes) return add_block({begin, end});
    Vec<3> low = middles_[*begin], high = low;
    for (const uint32_t* triangle = begin; triangle != end; ++triangle) {
      low = low.cwiseMin(middles_[*triangle]);
      high = high.cwiseMax(middles_[*triangle]);
    }
    Eigen::Index axis = 0;
    (high - low).maxCoeff(&axis);
    // Full blocks on the left.
    uint32_t* const half = begin + (count / 2 + kBlockLanes - 1) / kBlockLanes * kBlockLanes;
    std::nth_element(begin, half, end, [&](uint32_t a, uint32_t b) {
      const double at_a = middles_[a][axis], at_b = middles_[b][axis];
      return at_a < at_b || (at_a == at_b && a < b);
    });
    cut(begin, half);
    cut(half, end);
  }

 private:
  void add_block(std::span<const uint32_t> triangles) {
    DistanceBlock& block = out_.distances.emplace_back();
    double deviation = 0.0;
    for (size_t lane = 0; lane < kBlockLanes; ++lane) {
      const uint32_t triangle = triangles[lane < triangles.size() ? lane : 0];
      set_lane(block, lane, facets_.triangles[triangle].corners, triangle);
      deviation = std::max(deviation, out_.triangle_deviation[triangle]);
    }
    out_.count.push_back(static_cast<uint32_t>(triangles.size()));
    out_.deviation.push_back(deviation);
  }

  const FacetLevels& facets_;
  NeighbourBlocks& out_;
  std::vector<Vec<3>> middles_;
};

}  // namespace

NeighbourBlocks make_neighbour_blocks(const FacetLevels& facets) {
  NeighbourBlocks result;
  for (const FacetTriangle& triangle : facets.triangles)
    result.triangle_deviation.push_back(facets.deviation[triangle.facet]);
  Cutter cutter(facets, result);
  for (const FacetLevel& level : facets.levels) {
    std::vector<uint32_t> triangles(level.triangle_count);
    for (uint32_t i = 0; i < level.triangle_count; ++i) triangles[i] = level.first_triangle + i;
    cutter.cut(triangles.data(), triangles.data() + triangles.size());
    result.level_end.push_back(static_cast<uint32_t>(result.distances.size()));
  }
  return result;
}

}  // namespace barycast
