#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <span>

#include "query/distance_index.h"
#include "query/element_distance.h"
#include "query/grid_builder.h"
#include "query/grid_lanes.h"
#include "query/walk_ends.h"

namespace barycast {
namespace {

template <int D>
class DistanceGrid final : public DistanceIndex<D> {
 public:
  DistanceGrid(const Cage<D>& cage, std::unique_ptr<const DistanceIndex<D>> everywhere)
      : cage_(cage), everywhere_(std::move(everywhere)) {
    FacetLevels levels = make_facet_levels(cage);
    grid_ = build_grid(levels, D);
    if constexpr (D == 3) end_tables_ = make_end_tables(cage, levels);
    facets_ = std::move(levels.facets);
    triangles_ = std::move(levels.triangles);
  }

  using DistanceIndex<D>::closest;
  CagePoint<D> closest(const Vec<D>& x, double within) const override {
    const std::array<float, 3> point = in_floats(x);
    const uint32_t cell = grid_cell(grid_, point);
    if ((cell & kGridFarBit) != 0) return everywhere_->closest(x, within);
    Search search{x, {}, 0};
    search.best.distance_squared = std::numeric_limits<double>::infinity();
    uint32_t last = kNoFacet;  // a facet's triangles are neighbours
    for (const uint32_t block : grid_.blocks_of(cell))
      propose(grid_.blocks[block], point, grid_.slack(cell), search.best.distance_squared, [&](uint32_t triangle) {
        if (const uint32_t facet = triangles_[triangle].facet; facet != last) decide(last = facet, search);
      });
    return on_cage(facets_[search.facet], search.best);
  }

  void near(const WalkPositions& at, std::span<const uint32_t> walks, double tolerance,
            std::span<CagePoint<D>> ends) const override {
    if constexpr (D == 3) {
      std::array<WalkEnd, kEndsAtOnce> found;
      for (size_t begin = 0; begin < walks.size(); begin += kEndsAtOnce) {
        const auto some = walks.subspan(begin, std::min(kEndsAtOnce, walks.size() - begin));
        find_ends(grid_, end_tables_, at, some.data(), some.size(), found.data());
        for (size_t k = 0; k < some.size(); ++k) {
          const Vec<3> x = position_of<3>(at, some[k]);
          if (!end_at(x, found[k], tolerance, ends[begin + k])) ends[begin + k] = near(x, tolerance);
        }
      }
    } else {
      for (size_t k = 0; k < walks.size(); ++k) ends[k] = near(position_of<D>(at, walks[k]), tolerance);
    }
  }

  double free_radius(const Vec<D>& x) const override {
    const uint32_t cell = grid_cell(grid_, in_floats(x));
    if ((cell & kGridFarBit) != 0) return everywhere_->free_radius(x);
    return std::max(0.0, std::sqrt(nearest_triangle(x, cell).distance_squared) - double{grid_.slack(cell)});
  }

  void free_radii(const WalkPositions& at, uint32_t* hints, float* radii) const override {
    if (grid_radii(grid_, at, radii)) return;
    for (size_t i = 0; i < at.count; ++i) {
      if (radii[i] == kNotInGrid) radii[i] = distance_anywhere(position_of<D>(at, i), hints[i]);
    }
  }

  // By Embree, no further than the element that was closest last.
  float distance_anywhere(const Vec<D>& x, uint32_t& hint) const {
    double within = std::numeric_limits<double>::infinity();
    if (hint != kNoHint) within = std::sqrt(closest_on({hint, {}}, x).distance_squared);
    const CagePoint<D> closest = everywhere_->closest(x, within);
    hint = closest.element;
    return rounded_down(closest.distance);
  }

  size_t bytes() const override {
    return sizeof(*this) + grid_.bytes() + end_tables_.bytes() + facets_.capacity() * sizeof(Facet) +
           triangles_.capacity() * sizeof(FacetTriangle) + everywhere_->bytes();
  }

 private:
  static constexpr size_t kEndsAtOnce = 8 * kBlockLanes;
  static constexpr double kShareRounding = 1e-7;  // of floats
  static constexpr uint32_t kNoFacet = 0xFFFFFFFFu;
  struct Search {
    Vec<D> x;
    ElementPoint<D> best;
    uint32_t facet;
  };
  struct OnTriangle {
    TriangleShares shares;
    double distance_squared;
    uint32_t triangle;
  };

  static std::array<float, 3> in_floats(const Vec<D>& x) {
    std::array<float, 3> point{static_cast<float>(x[0]), static_cast<float>(x[1]), 0.0f};
    if constexpr (D == 3) point[2] = static_cast<float>(x[2]);
    return point;
  }

  // Floats propose the triangles of a block that may be nearer than a distance, squared, by the slack; the one with the
  // least bound first where none is known. Doubles decide.
  template <class Decide>
  void propose(const BoundBlock& block, const std::array<float, 3>& point, float slack, const double& squared,
               const Decide& decide) const {
    uint32_t asked = 0;
    if (std::isinf(squared)) {
      const uint32_t first = least_bound(block, point);
      decide(block.triangle[first]);
      asked = 1u << first;
    }
    const float reach =
        static_cast<float>(std::sqrt(squared)) * (1.0f + kBlockRelativeRounding) + slack + kBlockRounding;
    for (uint32_t lanes = bounds_below(block, point, reach * reach) & ~asked; lanes != 0; lanes &= lanes - 1)
      decide(block.triangle[static_cast<size_t>(std::countr_zero(lanes))]);
  }

  // At equal distances the element, then the facet.
  void decide(uint32_t facet, Search& search) const {
    const ElementPoint<D> candidate = closest_on(facets_[facet], search.x);
    if (candidate.distance_squared < search.best.distance_squared ||
        (candidate.distance_squared == search.best.distance_squared && precedes(facet, search.facet))) {
      search.best = candidate;
      search.facet = facet;
    }
  }

  // In double.
  CagePoint<D> near(const Vec<D>& x, double tolerance) const {
    const uint32_t cell = grid_cell(grid_, in_floats(x));
    // The facet of the nearest triangle may be farther than the closest one, by the deviations of both.
    if ((cell & kGridFarBit) != 0 || 2.0 * double{grid_.slack(cell)} > tolerance) return closest(x);
    return on_facet(x, nearest_triangle(x, cell));
  }

  // The point that floats found, if it is as near as they promised: they fail on slivers, where corners are nearest,
  // and on strongly twisted patches.
  bool end_at(const Vec<D>& x, const WalkEnd& found, double tolerance, CagePoint<D>& end) const requires(D == 3) {
    if (found.triangle == kNoTriangle || end_tables_.triangles[found.triangle].patch == EndTables::kNoEnd) return false;
    const FacetTriangle& triangle = triangles_[found.triangle];
    end.element = facets_[triangle.facet].element;
    const double first = double{found.first}, second = double{found.second};
    if (end_tables_.triangles[found.triangle].patch == EndTables::kNoPatch) {
      // On the edge opposite the first corner no basis but of the two others.
      const double rest = 1 - first - second;
      end.shares =
          rest < kShareRounding ? std::array{0.0, 1 - second, second, 0.0} : std::array{rest, first, second, 0.0};
      const auto& c = triangle.corners;
      end.point = end.shares[0] * c[0] + end.shares[1] * c[1] + end.shares[2] * c[2];
    } else {
      const BilinearPatch patch = patch_of(cage_, cage_.elements()[end.element]);
      end.shares = patch.shares(first, second);
      end.point = patch.at(first, second);
    }
    end.distance = (end.point - x).norm();
    // What is closest is no nearer than the bound of the triangles, by the slack and its rounding.
    const double least = double{found.bound} * (1 - double{kBlockRelativeRounding}) - double{found.slack};
    return end.distance <= least + tolerance;
  }

  OnTriangle nearest_triangle(const Vec<D>& x, uint32_t cell) const {
    const std::array<float, 3> point = in_floats(x);
    OnTriangle best{{}, std::numeric_limits<double>::infinity(), 0};
    for (const uint32_t block : grid_.blocks_of(cell))
      propose(grid_.blocks[block], point, 0.0f, best.distance_squared,
              [&](uint32_t triangle) { decide(triangle, x, best); });
    return best;
  }

  // At equal distances the lower number.
  void decide(uint32_t triangle, const Vec<D>& x, OnTriangle& best) const {
    const auto& c = triangles_[triangle].corners;
    Vec<3> in_space = Vec<3>::Zero();
    in_space.template head<D>() = x;
    const TriangleShares shares = closest_shares(in_space, c[0], c[1], c[2]);
    const double squared =
        (shares.first() * c[0] + shares.second * c[1] + shares.third * c[2] - in_space).squaredNorm();
    if (squared < best.distance_squared || (squared == best.distance_squared && triangle < best.triangle))
      best = {shares, squared, triangle};
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

  static CagePoint<D> on_cage(const Facet& facet, const ElementPoint<D>& at) {
    return {std::sqrt(at.distance_squared), facet.element, at.shares, at.point};
  }

  // From the closest point on a triangle to that on its facet.
  CagePoint<D> on_facet(const Vec<D>& x, const OnTriangle& on) const {
    using Part = FacetTriangle::Part;
    const FacetTriangle& triangle = triangles_[on.triangle];
    const Facet& facet = facets_[triangle.facet];
    if constexpr (D == 3) {
      const Element& element = cage_.elements()[facet.element];
      if (element.kind == ElementKind::kTriangle) {
        const std::array<double, 4> shares = {on.shares.first(), on.shares.second, on.shares.third, 0.0};
        return {std::sqrt(on.distance_squared), facet.element, shares,
                shares[0] * triangle.corners[0] + shares[1] * triangle.corners[1] + shares[2] * triangle.corners[2]};
      }
      if (triangle.part != Part::kAll) {
        const double both = on.shares.second + on.shares.third;
        const bool first = triangle.part == Part::kFirst;
        const double u = facet.window.u + facet.window.size * (first ? both : on.shares.second);
        const double v = facet.window.v + facet.window.size * (first ? on.shares.third : both);
        return on_cage(facet, closest_on_patch(x, patch_of(cage_, element), facet.window, u, v));
      }
    }
    // Segments; and patches with corners in one place, whose parameters say little.
    return on_cage(facet, closest_on(facet, x));
  }

  const Cage<D>& cage_;
  std::unique_ptr<const DistanceIndex<D>> everywhere_;
  std::vector<Facet> facets_;
  std::vector<FacetTriangle> triangles_;
  GridTables grid_;
  EndTables end_tables_;  // empty in the plane
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
