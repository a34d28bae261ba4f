#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "base/check.h"
#include "query/distance_index.h"
#include "query/element_distance.h"
#include "query/embree_device.h"

namespace barycast {
namespace {

// A patch is cut until its triangles follow it within this part of its size: one Newton run then finds
// the global minimum, and the triangles give radii that are nearly the distance.
constexpr double kDeviationOfSize = 0.05;
// ... and within this absolute deviation, so that walks need the exact patch for their last steps only.
constexpr double kDeviationMax = 2e-3;
constexpr int kCutsMax = 4;  // 16 x 16 windows
// Bounds the memory of an index; a cage of a million triangles fits.
constexpr size_t kFacetsMax = size_t{1} << 20;

// An element, or a window of a quad: what Embree sees.
template <int D>
struct Facet {
  uint32_t element;
  ElementKind kind;
  std::array<Vec<D>, 4> corner;
  double deviation = 0.0;  // of the patch from its two triangles
  PatchWindow window;
  TrianglePairDistance triangles;  // D = 3: the triangle, or the two of a quad
};

int cuts_of(const BilinearPatch& patch) {
  return patch.cuts(kDeviationMax, kDeviationOfSize, kCutsMax);
}

template <int D>
std::vector<Facet<D>> make_facets(const Cage<D>& cage) {
  std::vector<Facet<D>> facets;
  for (uint32_t e = 0; e < cage.elements().size(); ++e) {
    const Element& element = cage.elements()[e];
    if (element.kind != ElementKind::kQuad) {
      Facet<D> facet{.element = e, .kind = element.kind, .corner = {}, .window = {}, .triangles = {}};
      for (int i = 0; i < element.corner_count(); ++i) facet.corner[static_cast<size_t>(i)] = cage.corner(element, i);
      if constexpr (D == 3) {
        const std::array<Vec<3>, 3> triangle{facet.corner[0], facet.corner[1], facet.corner[2]};
        facet.triangles = {triangle, triangle};
      }
      facets.push_back(facet);
      continue;
    }
    if constexpr (D == 3) {
      const BilinearPatch patch = patch_of(cage, element);
      for (const PatchWindow& window : patch_windows(cuts_of(patch))) {
        const BilinearPatch part = patch.part(window);
        facets.push_back(
            {e,
             ElementKind::kQuad,
             part.corner,
             part.triangle_deviation(),
             window,
             {{part.corner[0], part.corner[1], part.corner[2]}, {part.corner[0], part.corner[2], part.corner[3]}}});
      }
    }
  }
  return facets;
}

// Float radius that covers a double one: Embree works in floats, and its query point is rounded.
float covering_radius(double radius, double reach) {
  return static_cast<float>(radius * (1 + 1e-5) + 1e-6 * (1 + reach));
}

template <int D>
class EmbreeDistance final : public DistanceIndex<D> {
 public:
  explicit EmbreeDistance(const Cage<D>& cage) : cage_(cage), facets_(make_facets(cage)) {
    for (const Facet<D>& facet : facets_) deviation_max_ = std::max(deviation_max_, facet.deviation);
  }

  Status build() {
    auto scene = make_embree_scene(static_cast<unsigned>(facets_.size()), &facets_, facet_bounds, nullptr);
    if (!scene) return scene.error();
    scene_ = std::move(scene).value();
    return Done{};
  }

  using DistanceIndex<D>::closest;
  CagePoint<D> closest(const Vec<D>& x, double within) const override {
    ClosestSearch search{this, x, x.norm(), {}, kNoHint};
    search.best.distance_squared = std::numeric_limits<double>::infinity();
    run(x, covering_radius(within, search.reach), visit_closest, &search);
    BARYCAST_CHECK(search.facet != kNoHint);
    return {std::sqrt(search.best.distance_squared), facets_[search.facet].element, search.best.shares,
            search.best.point};
  }

  void near(const WalkPositions& at, std::span<const uint32_t> walks, double /*tolerance*/,
            std::span<CagePoint<D>> ends) const override {
    for (size_t k = 0; k < walks.size(); ++k) ends[k] = closest(position_of<D>(at, walks[k]));
  }

  double free_radius(const Vec<D>& x) const override { return closest(x).distance; }

  void free_radii(const WalkPositions& at, uint32_t* hints, float* radii) const override {
    for (size_t i = 0; i < at.count; ++i) {
      const Vec<D> x = position_of<D>(at, i);
      RadiusSearch search{this, x, x.norm(), std::numeric_limits<double>::infinity(), hints[i]};
      float radius = std::numeric_limits<float>::infinity();
      if (hints[i] != kNoHint) {
        search.radius = lower_bound(facets_[hints[i]], x);
        radius = search.cover();
      }
      run(x, radius, visit_radius, &search);
      hints[i] = search.facet;
      radii[i] = rounded_down(search.radius);
    }
  }

  size_t bytes() const override {
    // Embree's tree of user primitives: about 100 bytes each, and a page or two.
    return sizeof(*this) + facets_.size() * (sizeof(Facet<D>) + 100) + 16384;
  }

 private:
  struct ClosestSearch {
    const EmbreeDistance* index;
    Vec<D> x;
    double reach;
    ElementPoint<D> best;
    uint32_t facet;
  };
  struct RadiusSearch {
    const EmbreeDistance* index;
    Vec<D> x;
    double reach;
    double radius;
    uint32_t facet;
    // A facet's bound falls short of its distance by two deviations at most; searching that much further
    // makes the minimum independent of the order of visits.
    float cover() const { return covering_radius(radius + 2 * index->deviation_max_, reach); }
  };

  static void facet_bounds(const RTCBoundsFunctionArguments* args) {
    const Facet<D>& facet = (*static_cast<const std::vector<Facet<D>>*>(args->geometryUserPtr))[args->primID];
    Vec<D> low = facet.corner[0], high = low;
    for (int i = 1; i < 2 + static_cast<int>(facet.kind); ++i) {
      low = low.cwiseMin(facet.corner[static_cast<size_t>(i)]);
      high = high.cwiseMax(facet.corner[static_cast<size_t>(i)]);
    }
    *args->bounds_o = embree_box<D>(low, high, 0.0);
  }

  void run(const Vec<D>& x, float radius, RTCPointQueryFunction visit, void* search) const {
    RTCPointQuery query{};
    query.x = static_cast<float>(x[0]);
    query.y = static_cast<float>(x[1]);
    if constexpr (D == 3) query.z = static_cast<float>(x[2]);
    query.radius = radius;
    RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    rtcPointQuery(scene_.get(), &query, &context, visit, search);
  }

  ElementPoint<D> closest_on(const Facet<D>& facet, const Vec<D>& x) const {
    if constexpr (D == 3) {
      if (facet.kind == ElementKind::kTriangle)
        return closest_on_triangle(x, facet.corner[0], facet.corner[1], facet.corner[2]);
      if (facet.kind == ElementKind::kQuad)
        return closest_on_patch(x, patch_of(cage_, cage_.elements()[facet.element]), facet.window);
    }
    return closest_on_segment<D>(x, facet.corner[0], facet.corner[1]);
  }

  // At most the distance to the facet; at least half of it, but for some millionths of the facet's size.
  double lower_bound(const Facet<D>& facet, const Vec<D>& x) const {
    if constexpr (D == 3) {
      const double by_triangles = facet.triangles.lower_bound(x);
      if (facet.kind == ElementKind::kTriangle) return by_triangles;
      if (by_triangles >= 4 * facet.deviation) return by_triangles - facet.deviation;
    }
    return std::sqrt(closest_on(facet, x).distance_squared);
  }

  static bool visit_closest(RTCPointQueryFunctionArguments* args) {
    auto& search = *static_cast<ClosestSearch*>(args->userPtr);
    const Facet<D>& facet = search.index->facets_[args->primID];
    const ElementPoint<D> candidate = search.index->closest_on(facet, search.x);
    const bool nearer = candidate.distance_squared < search.best.distance_squared ||
                        (candidate.distance_squared == search.best.distance_squared && args->primID < search.facet);
    if (!nearer) return false;
    search.best = candidate;
    search.facet = args->primID;
    args->query->radius = covering_radius(std::sqrt(candidate.distance_squared), search.reach);
    return true;
  }

  static bool visit_radius(RTCPointQueryFunctionArguments* args) {
    auto& search = *static_cast<RadiusSearch*>(args->userPtr);
    if (args->primID == search.facet) return false;  // the hint, already counted
    const double bound = search.index->lower_bound(search.index->facets_[args->primID], search.x);
    if (!(bound < search.radius)) return false;
    search.radius = bound;
    search.facet = args->primID;
    args->query->radius = search.cover();
    return true;
  }

  const Cage<D>& cage_;
  std::vector<Facet<D>> facets_;
  double deviation_max_ = 0.0;
  EmbreeScene scene_;
};

}  // namespace

// Twisted quads would make the index far larger than the cage.
template <int D>
Status check_distance_index(const Cage<D>& cage) {
  size_t count = cage.elements().size();
  if constexpr (D == 3)
    for (const Element& element : cage.elements())
      if (element.kind == ElementKind::kQuad) count += (size_t{1} << (2 * cuts_of(patch_of(cage, element)))) - 1;
  if (count <= kFacetsMax) return Done{};
  return Error{ErrorCode::kResourceExhausted, "cage.quads",
               "the quads are so many and so twisted that they would need " + std::to_string(count) +
                   " flat facets, more than " + std::to_string(kFacetsMax) +
                   "; use more and flatter quads, or triangles"};
}

template <int D>
Result<std::unique_ptr<const DistanceIndex<D>>> make_embree_distance_index(const Cage<D>& cage) {
  if (auto status = check_distance_index(cage); !status) return status.error();
  auto index = std::make_unique<EmbreeDistance<D>>(cage);
  if (auto status = index->build(); !status) return status.error();
  return std::unique_ptr<const DistanceIndex<D>>(std::move(index));
}

template Status check_distance_index(const Cage<2>&);
template Status check_distance_index(const Cage<3>&);
template Result<std::unique_ptr<const DistanceIndex<2>>> make_embree_distance_index(const Cage<2>&);
template Result<std::unique_ptr<const DistanceIndex<3>>> make_embree_distance_index(const Cage<3>&);

}  // namespace barycast
