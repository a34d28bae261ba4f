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
// Lines that an index is asked for together: its vectors are full, and a request that is cancelled ends soon.
constexpr uint32_t kLinesTogether = 64;
// Rays as printed, which may turn out to be too many.
constexpr uint32_t kRaysTogether = 16;
// Directions that are kept; more are cheap next to their lines.
constexpr uint32_t kLatticeKept = 4096;

// Directions towards the enclosing ball, from outside of it.
template <int D>
Cone<D> cone_of_ball(const Vec<D>& origin) {
  const double distance = origin.norm(), sine = kEnclosingBall / distance;
  return {-origin / distance, sine * sine / (1 + std::sqrt(1 - sine * sine))};
}

// By some turns about the first axis. In the plane, none.
template <int D>
Mat<D> turned(const Mat<D>& rotation, double turns) {
  if constexpr (D == 2) return rotation;
  const SineCosine angle = sine_cosine_of_turns(turns);
  Mat<D> result = rotation;
  result.col(D - 2) = angle.cosine * rotation.col(D - 2) + angle.sine * rotation.col(D - 1);
  result.col(D - 1) = angle.cosine * rotation.col(D - 1) - angle.sine * rotation.col(D - 2);
  return result;
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
  if (settings.as_printed) return;
  for (uint32_t line = 0; line < std::min(line_count(), kLatticeKept); ++line)
    lattice_.push_back(lattice_direction(line));
}

template <int D>
template <class Iterator>
void RaySamples<D>::add_ray(const Vec<D>& origin, const LineHits<D>& hits, Iterator nearest, Iterator end,
                            SampleSet<D>& out) const {
  auto count = std::distance(nearest, end);
  // What is visible: from inside (an odd number of hits) the first; from outside the first two, of which the
  // second balances the first [SBC Eq. 12].
  if (settings_.visible_only && count > 0) count = count % 2 == 1 ? 1 : 2;
  double sign = 1.0;
  for (Iterator at = nearest; at != nearest + count; ++at) {
    const LineHit<D>& hit = hits.hits[*at];
    const double distance = (hit.point - origin).norm();
    if (distance > 0) out.samples.push_back({hit.point, sign / distance, hit.shares, hit.element, SampleEnd::kHit});
    sign = -sign;
  }
}

// Half of all directions: lines have no sign.
template <int D>
Vec<D> RaySamples<D>::lattice_direction(uint32_t line) const {
  return Cone<D>{Vec<D>::UnitX(), 1.0}.direction((line + 0.5) / line_count(), golden_turns(line, 0.0));
}

template <int D>
bool RaySamples<D>::sample_lattice(const Vec<D>& origin, const QueryRandom& random, const std::atomic<bool>& cancel,
                                   Workspace& workspace, SampleSet<D>& out) const {
  const bool outside = origin.squaredNorm() > kEnclosingBall * kEnclosingBall;
  const std::array<double, 2> first = random.pair(0, 0), second = random.pair(0, 1);
  const Cone<D> cone = outside ? cone_of_ball<D>(origin) : Cone<D>{};
  // Not a number that the rotation has used: it would no longer be uniform.
  const Mat<D> rotation = outside ? Mat<D>() : turned<D>(uniform_rotation<D>(first, second), second[1]);
  const auto direction = [&](uint32_t line) -> Vec<D> {
    if (outside) return cone.direction((line + first[0]) / settings_.rays, golden_turns(line, first[1]));
    return rotation * (line < lattice_.size() ? lattice_[line] : lattice_direction(line));
  };
  const uint32_t count = outside ? settings_.rays : line_count();
  out.counts.started = outside ? count : 2 * uint64_t{count};
  for (uint32_t begin = 0; begin < count; begin += kLinesTogether) {
    if (cancel.load(std::memory_order_relaxed)) return false;
    const uint32_t end = std::min(count, begin + kLinesTogether);
    workspace.directions.clear();
    for (uint32_t line = begin; line < end; ++line) workspace.directions.push_back(direction(line));
    const LineHits<D>& hits = workspace.hits;
    lines_.hits(origin, workspace.directions, outside ? 0.0 : -kInfinity, workspace.hits);
    for (uint32_t line = 0; line < end - begin; ++line) {
      const std::span<const uint32_t> order = hits.of_line(line);
      const auto forward =
          std::find_if(order.begin(), order.end(), [&](uint32_t hit) { return !(hits.hits[hit].t < 0); });
      add_ray(origin, hits, forward, order.end(), out);
      add_ray(origin, hits, std::make_reverse_iterator(forward), order.rend(), out);
    }
  }
  return true;
}

template <int D>
bool RaySamples<D>::sample_as_printed(const Vec<D>& origin, const QueryRandom& random, const std::atomic<bool>& cancel,
                                      Workspace& workspace, SampleSet<D>& out) const {
  const Cone<D> cone = cone_of_box<D>(origin, box_low_, box_high_);
  for (uint32_t begin = 0; begin < settings_.rays; begin += kRaysTogether) {
    if (cancel.load(std::memory_order_relaxed)) return false;
    const uint32_t end = std::min(settings_.rays, begin + kRaysTogether);
    workspace.directions.clear();
    for (uint32_t ray = begin; ray < end; ++ray) {
      const std::array<double, 2> numbers = random.pair(ray, 0);
      workspace.directions.push_back(cone.direction(numbers[0], numbers[1]));
    }
    lines_.hits(origin, workspace.directions, 0.0, workspace.hits);
    for (uint32_t ray = 0; ray < end - begin; ++ray) {
      if (out.samples.size() >= settings_.rays) return true;
      const std::span<const uint32_t> order = workspace.hits.of_line(ray);
      add_ray(origin, workspace.hits, order.begin(), order.end(), out);
      ++out.counts.started;
    }
  }
  return true;
}

template <int D>
bool RaySamples<D>::sample(std::span<const SampleQuery<D>> queries, const std::atomic<bool>& cancel,
                           std::span<SampleSet<D>> out) const {
  thread_local Workspace workspace;
  for (size_t i = 0; i < queries.size(); ++i) {
    const SampleQuery<D>& query = queries[i];
    out[i].clear();
    const bool complete = settings_.as_printed
                              ? sample_as_printed(query.origin, query.random, cancel, workspace, out[i])
                              : sample_lattice(query.origin, query.random, cancel, workspace, out[i]);
    if (!complete) return false;
  }
  return true;
}

template class RaySamples<2>;
template class RaySamples<3>;

}  // namespace barycast
