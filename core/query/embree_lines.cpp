#include <algorithm>
#include <cmath>

#include "query/embree_device.h"
#include "query/line_index.h"

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
  std::vector<uint32_t>* candidates;
};

template <int D>
class EmbreeLines final : public LineIndex<D> {
 public:
  explicit EmbreeLines(const Cage<D>& cage) : cage_(cage) {}

  Status build() {
    auto scene = make_embree_scene(static_cast<unsigned>(cage_.elements().size()), this, element_bounds, propose);
    if (!scene) return scene.error();
    scene_ = std::move(scene).value();
    return Done{};
  }

  std::unique_ptr<LinePencil<D>> pencil() const override { return std::make_unique<Pencil>(*this); }

  size_t bytes() const override {
    // Embree's tree of user primitives: about 100 bytes each, and a page or two.
    return sizeof(*this) + cage_.elements().size() * 100 + 16384;
  }

 private:
  class Pencil final : public LinePencil<D> {
   public:
    explicit Pencil(const EmbreeLines& lines) : lines_(lines) {}
    void set_origin(const Vec<D>& origin) override { origin_ = origin; }
    void hits(const Vec<D>& direction, double from, std::vector<LineHit<D>>& out) override {
      const Line<D> line(origin_, direction);
      out.clear();
      candidates_.clear();
      lines_.propose_candidates(line, from, candidates_);
      for (const uint32_t element : candidates_) append_hits(line, lines_.cage_, element, from, out);
      sort_hits(out);
    }

   private:
    const EmbreeLines& lines_;
    Vec<D> origin_ = Vec<D>::Zero();
    std::vector<uint32_t> candidates_;
  };

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
    reinterpret_cast<const Query*>(args->context)->candidates->push_back(args->primID);
  }

  void propose_candidates(const Line<D>& line, double from, std::vector<uint32_t>& candidates) const {
    // Only the part within the cage's ball, measured from where the line is nearest to the origin: far away
    // floats could not hold it.
    const double nearest = -line.origin().dot(line.direction());
    const Vec<D> foot = line.origin() + nearest * line.direction();
    const double squared = kCageRadius * kCageRadius - foot.squaredNorm();
    if (!(squared > 0)) return;
    const double half = std::sqrt(squared);
    const double begin = std::max(-half, from - nearest - kPadding);
    if (begin >= half) return;
    const Vec<D> start = foot + begin * line.direction();
    RTCRayHit ray{};
    float* const org[3] = {&ray.ray.org_x, &ray.ray.org_y, &ray.ray.org_z};
    float* const dir[3] = {&ray.ray.dir_x, &ray.ray.dir_y, &ray.ray.dir_z};
    for (int i = 0; i < D; ++i) {
      *org[i] = static_cast<float>(start[i]);
      *dir[i] = static_cast<float>(line.direction()[i]);
    }
    ray.ray.tfar = static_cast<float>(half - begin + kPadding);
    ray.ray.mask = 0xFFFFFFFFu;
    ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    Query query{{}, &candidates};
    rtcInitIntersectContext(&query.context);
    rtcIntersect1(scene_.get(), &query.context, &ray);
  }

  const Cage<D>& cage_;
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
