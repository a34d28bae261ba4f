#include "sample/rays.h"

#include <algorithm>
#include <iterator>
#include <limits>

#include "sample/directions.h"

namespace barycast {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// The cage lies in the ball of half a diagonal about the origin; just outside of it, half of all directions
// are the cone's, so that nothing jumps where a query passes.
constexpr double kEnclosingBall = 0.5 * (1 + 1e-9);

// Directions towards the enclosing ball, from outside of it.
template <int D>
Cone<D> cone_of_ball(const Vec<D>& origin) {
  const double distance = origin.norm(), sine = kEnclosingBall / distance;
  return {-origin / distance, sine * sine / (1 + std::sqrt(1 - sine * sine))};
}

// The narrowest cone about the direction to a box's centre that holds the box; all directions from within
// [SBC 6, Selection of Random Rays].
template <int D>
Cone<D> cone_of_box(const Vec<D>& origin, const Vec<D>& low, const Vec<D>& high) {
  if ((origin.array() >= low.array()).all() && (origin.array() <= high.array()).all()) return {Vec<D>::UnitX(), 2.0};
  Cone<D> cone{((low + high) / 2 - origin).normalized(), 0.0};
  for (int corner = 0; corner < 1 << D; ++corner) {
    Vec<D> to_corner = -origin;
    for (int i = 0; i < D; ++i) to_corner[i] += (corner >> i & 1) != 0 ? high[i] : low[i];
    to_corner.normalize();
    const double cosine = std::clamp(cone.axis.dot(to_corner), -1.0, 1.0);
    const double sine_squared = (to_corner - cosine * cone.axis).squaredNorm();
    cone.depth = std::max(cone.depth, cosine > 0 ? sine_squared / (1 + cosine) : 1 - cosine);
  }
  return cone;
}

}  // namespace

template <int D>
RaySamples<D>::RaySamples(const Cage<D>& cage, const LineIndex<D>& lines, const RaySettings& settings)
    : lines_(lines), settings_(settings), box_low_(Vec<D>::Constant(kInfinity)), box_high_(-box_low_) {
  for (const uint32_t v : cage.used_vertices()) {
    box_low_ = box_low_.cwiseMin(cage.control_vertices()[v]);
    box_high_ = box_high_.cwiseMax(cage.control_vertices()[v]);
  }
}

// The hits of one ray, nearest first.
template <int D>
template <class Iterator>
void RaySamples<D>::add_ray(const Vec<D>& origin, Iterator nearest, Iterator end, SampleSet<D>& out) const {
  auto count = std::distance(nearest, end);
  // What is visible: from inside (an odd number of hits) the first; from outside the first two, of which the
  // second balances the first [SBC Eq. 12].
  if (settings_.visible_only && count > 0) count = count % 2 == 1 ? 1 : 2;
  double sign = 1.0;
  for (Iterator hit = nearest; hit != nearest + count; ++hit) {
    const double distance = (hit->point - origin).norm();
    if (distance > 0) out.samples.push_back({hit->point, sign / distance, hit->shares, hit->element, SampleEnd::kHit});
    sign = -sign;
  }
}

template <int D>
bool RaySamples<D>::sample_lattice(LinePencil<D>& lines, const Vec<D>& origin, const QueryRandom& random,
                                   const std::atomic<bool>& cancel, SampleSet<D>& out) const {
  thread_local std::vector<LineHit<D>> hits;
  const bool outside = origin.squaredNorm() > kEnclosingBall * kEnclosingBall;
  const std::array<double, 2> first = random.pair(0, 0), second = random.pair(0, 1);
  // Not a number that the rotation has used: it would no longer be uniform.
  const double shift = outside ? first[1] : second[1];
  // Lines have no sign: half of all directions are enough for them.
  const Cone<D> cone = outside ? cone_of_ball<D>(origin) : Cone<D>{Vec<D>::UnitX(), 1.0};
  const Mat<D> rotation = outside ? Mat<D>(Mat<D>::Identity()) : uniform_rotation<D>(first, second);
  const uint32_t count = outside ? settings_.rays : (settings_.rays + 1) / 2;
  out.counts.started = outside ? count : 2 * uint64_t{count};
  for (uint32_t i = 0; i < count; ++i) {
    if (i % 64 == 0 && cancel.load(std::memory_order_relaxed)) return false;
    const double fraction = (i + (outside ? first[0] : 0.5)) / count;
    lines.hits(rotation * cone.direction(fraction, golden_turns(i, shift)), outside ? 0.0 : -kInfinity, hits);
    const auto forward =
        std::partition_point(hits.begin(), hits.end(), [](const LineHit<D>& hit) { return hit.t < 0; });
    add_ray(origin, forward, hits.end(), out);
    add_ray(origin, std::make_reverse_iterator(forward), hits.rend(), out);
  }
  return true;
}

template <int D>
bool RaySamples<D>::sample_as_printed(LinePencil<D>& lines, const Vec<D>& origin, const QueryRandom& random,
                                      const std::atomic<bool>& cancel, SampleSet<D>& out) const {
  thread_local std::vector<LineHit<D>> hits;
  const Cone<D> cone = cone_of_box<D>(origin, box_low_, box_high_);
  for (uint32_t ray = 0; ray < settings_.rays && out.samples.size() < settings_.rays; ++ray) {
    if (ray % 64 == 0 && cancel.load(std::memory_order_relaxed)) return false;
    const std::array<double, 2> numbers = random.pair(ray, 0);
    lines.hits(cone.direction(numbers[0], numbers[1]), 0.0, hits);
    add_ray(origin, hits.begin(), hits.end(), out);
    ++out.counts.started;
  }
  return true;
}

template <int D>
bool RaySamples<D>::sample(std::span<const SampleQuery<D>> queries, const std::atomic<bool>& cancel,
                           std::span<SampleSet<D>> out) const {
  const std::unique_ptr<LinePencil<D>> lines = lines_.pencil();
  for (size_t i = 0; i < queries.size(); ++i) {
    const SampleQuery<D>& query = queries[i];
    out[i].clear();
    lines->set_origin(query.origin);
    const bool complete = settings_.as_printed ? sample_as_printed(*lines, query.origin, query.random, cancel, out[i])
                                               : sample_lattice(*lines, query.origin, query.random, cancel, out[i]);
    if (!complete) return false;
  }
  return true;
}

template class RaySamples<2>;
template class RaySamples<3>;

}  // namespace barycast
