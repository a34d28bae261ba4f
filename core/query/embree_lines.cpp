#include <algorithm>
#include <cmath>
#include <iterator>

#include "query/embree_device.h"
#include "query/line_index.h"
#include "query/meet_lanes.h"

namespace barycast {
namespace {

// Embree sees the line in floats, and within half a diagonal of the origin, where the cage is: its boxes are
// padded by more than what rounding may move either.
constexpr double kPadding = 4e-6;
// The cage lies in the ball of this radius.
constexpr double kCageRadius = 0.5 + kPadding;

// What Embree hands back to the callback.
struct Query {
  RTCIntersectContext context;  // first: Embree knows this part only
  uint32_t line;
  std::vector<LineCandidate>* candidates;
};

template <int D>
class EmbreeLines final : public LineIndex<D> {
 public:
  explicit EmbreeLines(const Cage<D>& cage) : cage_(cage) {
    if constexpr (D == 3) corners_ = corners_of(cage);
  }

  Status build() {
    auto scene = make_embree_scene(static_cast<unsigned>(cage_.elements().size()), this, element_bounds, propose);
    if (!scene) return scene.error();
    scene_ = std::move(scene).value();
    return Done{};
  }

  void hits(const Vec<D>& origin, std::span<const Vec<D>> directions, double from, LineHits<D>& out) const override {
    out.hits.clear();
    auto& [candidates, quads] = out.candidates;
    candidates.clear();
    for (uint32_t i = 0; i < directions.size(); ++i) propose_candidates(origin, directions[i], from, i, candidates);
    if constexpr (D == 3) {
      // Triangles stay.
      quads.clear();
      const auto is_quad = [&](const LineCandidate& c) {
        return cage_.elements()[c.element].kind == ElementKind::kQuad;
      };
      std::copy_if(candidates.begin(), candidates.end(), std::back_inserter(quads), is_quad);
      std::erase_if(candidates, is_quad);
      meet_candidates(corners_, false, origin, directions, candidates, from, out.hits);
      meet_candidates(corners_, true, origin, directions, quads, from, out.hits);
    } else {
      std::array<LineHit<D>, 2> found;
      for (const LineCandidate& c : candidates) {
        if (meet(origin, directions[c.line], cage_, c.element, found) == 0 || !(found[0].t > from)) continue;
        found[0].line = c.line;
        out.hits.push_back(found[0]);
      }
    }
    order_hits(directions.size(), out);
  }

  size_t bytes() const override {
    // Embree's tree of user primitives: about 100 bytes each, and a page or two.
    return sizeof(*this) + cage_.elements().size() * 100 + 16384 + corners_.capacity() * sizeof(ElementCorners);
  }

 private:
  static void element_bounds(const RTCBoundsFunctionArguments* args) {
    const Cage<D>& cage = static_cast<const EmbreeLines*>(args->geometryUserPtr)->cage_;
    const Element& element = cage.elements()[args->primID];
    Vec<D> low = cage.corner(element, 0), high = low;
    for (int i = 1; i < element.corner_count(); ++i) {
      low = low.cwiseMin(cage.corner(element, i));
      high = high.cwiseMax(cage.corner(element, i));
    }
    *args->bounds_o = embree_box<D>(low, high, kPadding);
  }

  // Collects, and reports no hit, so that the traversal goes on.
  static void propose(const RTCIntersectFunctionNArguments* args) {
    const auto& query = *reinterpret_cast<const Query*>(args->context);
    query.candidates->push_back({query.line, args->primID});
  }

  void propose_candidates(const Vec<D>& origin, const Vec<D>& direction, double from, uint32_t line,
                          std::vector<LineCandidate>& candidates) const {
    // Only the part within the cage's ball, measured from where the line is nearest to the origin: far away
    // floats could not hold it.
    const double nearest = -origin.dot(direction);
    const Vec<D> foot = origin + nearest * direction;
    const double squared = kCageRadius * kCageRadius - foot.squaredNorm();
    if (!(squared > 0)) return;
    const double half = std::sqrt(squared);
    const double begin = std::max(-half, from - nearest - kPadding);
    if (begin >= half) return;
    const Vec<D> start = foot + begin * direction;
    RTCRayHit ray{};
    float* const org[3] = {&ray.ray.org_x, &ray.ray.org_y, &ray.ray.org_z};
    float* const dir[3] = {&ray.ray.dir_x, &ray.ray.dir_y, &ray.ray.dir_z};
    for (int i = 0; i < D; ++i) {
      *org[i] = static_cast<float>(start[i]);
      *dir[i] = static_cast<float>(direction[i]);
    }
    ray.ray.tfar = static_cast<float>(half - begin + kPadding);
    ray.ray.mask = 0xFFFFFFFFu;
    ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    Query query{{}, line, &candidates};
    rtcInitIntersectContext(&query.context);
    rtcIntersect1(scene_.get(), &query.context, &ray);
  }

  const Cage<D>& cage_;
  std::vector<ElementCorners> corners_;  // D = 3
  EmbreeScene scene_;
};

}  // namespace

template <int D>
Result<std::unique_ptr<const LineIndex<D>>> make_embree_line_index(const Cage<D>& cage) {
  auto index = std::make_unique<EmbreeLines<D>>(cage);
  if (auto status = index->build(); !status) return status.error();
  return std::unique_ptr<const LineIndex<D>>(std::move(index));
}

template Result<std::unique_ptr<const LineIndex<2>>> make_embree_line_index(const Cage<2>&);
template Result<std::unique_ptr<const LineIndex<3>>> make_embree_line_index(const Cage<3>&);

}  // namespace barycast
