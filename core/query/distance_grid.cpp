#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "query/distance_index.h"
#include "query/element_distance.h"
#include "query/grid_builder.h"
#include "query/grid_lanes.h"

namespace barycast {
namespace {

template <int D>
class DistanceGrid final : public DistanceIndex<D> {
 public:
  DistanceGrid(const Cage<D>& cage, std::unique_ptr<const DistanceIndex<D>> everywhere)
      : cage_(cage), everywhere_(std::move(everywhere)) {
    FacetLevels levels = make_facet_levels(cage);
    grid_ = build_grid(levels, D);
    facets_ = std::move(levels.facets);
    triangles_ = std::move(levels.triangles);
  }

  CagePoint<D> closest(const Vec<D>& x) const override {
    const std::array<float, 3> point = in_floats(x);
    const uint32_t cell = grid_cell(grid_, point);
    if ((cell & kGridFarBit) != 0) return everywhere_->closest(x);
    Search search{x, point, grid_.slack[grid_list_begin(cell)], {}, 0, std::numeric_limits<float>::infinity()};
    search.best.distance_squared = std::numeric_limits<double>::infinity();
    for (const uint32_t block : blocks_of(cell)) visit(grid_.blocks[block], search);
    return {std::sqrt(search.best.distance_squared), facets_[search.facet].element, search.best.shares,
            search.best.point};
  }

  CagePoint<D> near(const Vec<D>& x, double tolerance) const override {
    const std::array<float, 3> point = in_floats(x);
    const uint32_t cell = grid_cell(grid_, point);
    // The facet of the nearest triangle may be farther than the closest one, by the deviations of both.
    if ((cell & kGridFarBit) != 0 || 2.0 * double{grid_.slack[grid_list_begin(cell)]} > tolerance) return closest(x);
    return below(x, triangles_[grid_nearest(grid_, cell, point)]);
  }

  void free_radii(const WalkPositions& at, uint32_t* /*hints*/, float* radii) const override {
    grid_radii(grid_, at, radii);
    for (size_t i = 0; i < at.count; ++i) {
      if (radii[i] == kNotInGrid) radii[i] = rounded_down(everywhere_->closest(position_of<D>(at, i)).distance);
    }
  }

  size_t bytes() const override {
    return sizeof(*this) + grid_.bytes() + facets_.capacity() * sizeof(Facet) +
           triangles_.capacity() * sizeof(FacetTriangle) + everywhere_->bytes();
  }

 private:
  struct Search {
    Vec<D> x;
    std::array<float, 3> point;
    float slack;
    ElementPoint<D> best;
    uint32_t facet;
    float reach;  // no triangle farther than this can be of the closest facet; infinite to begin with
  };

  static std::array<float, 3> in_floats(const Vec<D>& x) {
    std::array<float, 3> point{static_cast<float>(x[0]), static_cast<float>(x[1]), 0.0f};
    if constexpr (D == 3) point[2] = static_cast<float>(x[2]);
    return point;
  }

  std::span<const uint32_t> blocks_of(uint32_t cell) const {
    return std::span(grid_.lists).subspan(grid_list_begin(cell), grid_list_length(cell));
  }

  // Floats propose the triangles of a block; doubles decide, and at equal distances the element, then the facet.
  void visit(const TriangleBlock& block, Search& search) const {
    TriangleBlock::Lanes squared;
    block_distances_squared(block, search.point, squared);
    const float least = std::sqrt(*std::min_element(squared.begin(), squared.end()));
    const float margin = 2.0f * (search.slack + kBlockRounding + kBlockRelativeRounding * least);
    search.reach = std::min(search.reach, least + margin);
    std::array<uint32_t, kBlockLanes> seen;
    size_t seen_count = 0;
    for (size_t lane = 0; lane < kBlockLanes; ++lane) {
      if (squared[lane] > search.reach * search.reach) continue;
      const uint32_t facet = triangles_[block.triangle[lane]].facet;
      const auto seen_end = seen.begin() + static_cast<std::ptrdiff_t>(seen_count);
      if (std::find(seen.begin(), seen_end, facet) != seen_end) continue;
      seen[seen_count++] = facet;
      const ElementPoint<D> candidate = closest_on(facets_[facet], search.x);
      if (candidate.distance_squared < search.best.distance_squared ||
          (candidate.distance_squared == search.best.distance_squared && precedes(facet, search.facet))) {
        search.best = candidate;
        search.facet = facet;
      }
    }
  }

  bool precedes(uint32_t a, uint32_t b) const {
    const uint32_t ea = facets_[a].element, eb = facets_[b].element;
    return ea < eb || (ea == eb && a < b);
  }

  ElementPoint<D> closest_on(const Facet& facet, const Vec<D>& x) const {
    const Element& element = cage_.elements()[facet.element];
    if constexpr (D == 3) {
      if (element.kind == ElementKind::kQuad) return closest_on_patch(x, patch_of(cage_, element), facet.window);
      return closest_on_triangle(x, cage_.corner(element, 0), cage_.corner(element, 1), cage_.corner(element, 2));
    } else {
      return closest_on_segment<D>(x, cage_.corner(element, 0), cage_.corner(element, 1));
    }
  }

  // The closest point on the triangle's facet.
  CagePoint<D> below(const Vec<D>& x, const FacetTriangle& triangle) const {
    const Facet& facet = facets_[triangle.facet];
    ElementPoint<D> result;
    if constexpr (D == 3) {
      const Element& element = cage_.elements()[facet.element];
      result = closest_on_triangle(x, triangle.corners[0], triangle.corners[1], triangle.corners[2]);
      if (element.kind == ElementKind::kQuad) {
        // Of a facet's two triangles, the first has its corners 0, 1, 2, the second 0, 2, 3.
        const bool first = &triangle == triangles_.data() || (&triangle - 1)->facet != triangle.facet;
        const auto& s = result.shares;
        const double u = facet.window.u + facet.window.size * (first ? s[1] + s[2] : s[1]);
        const double v = facet.window.v + facet.window.size * (first ? s[2] : s[1] + s[2]);
        result = closest_on_patch(x, patch_of(cage_, element), facet.window, u, v);
      }
    } else {
      result = closest_on(facet, x);
    }
    return {std::sqrt(result.distance_squared), facet.element, result.shares, result.point};
  }

  const Cage<D>& cage_;
  std::unique_ptr<const DistanceIndex<D>> everywhere_;
  std::vector<Facet> facets_;
  std::vector<FacetTriangle> triangles_;
  GridTables grid_;
};

}  // namespace

template <int D>
Result<std::unique_ptr<const DistanceIndex<D>>> make_distance_grid(const Cage<D>& cage) {
  auto everywhere = make_embree_distance_index(cage);
  if (!everywhere) return everywhere.error();
  return std::unique_ptr<const DistanceIndex<D>>(
      std::make_unique<DistanceGrid<D>>(cage, std::move(everywhere).value()));
}

template Result<std::unique_ptr<const DistanceIndex<2>>> make_distance_grid(const Cage<2>&);
template Result<std::unique_ptr<const DistanceIndex<3>>> make_distance_grid(const Cage<3>&);

}  // namespace barycast
