#include "estimate/point_estimator.h"

#include <cmath>
#include <limits>

#include "base/random.h"
#include "base/tolerances.h"
#include "query/element_distance.h"

namespace barycast {
namespace {

// Nearer than this part of the thickness, the direction from the cage to the query is rounding: with the
// default thickness 1e-6 diagonals, a few roundings of a query that was stored in float.
constexpr double kTie = 1e-3;

}  // namespace

template <int D>
PointEstimator<D>::PointEstimator(const Cage<D>& cage, const DistanceIndex<D>& distance,
                                  const WindingNumber<D>& winding, Sampler<D> sampler, const Settings& settings)
    : cage_(cage),
      distance_(distance),
      winding_(winding),
      sampler_(std::move(sampler)),
      settings_(settings),
      projection_(cage) {}

// Where a query on the cage takes its samples from [SBC 4.5]: away from the cage, on the query's own
// side; on the inside where the query lies exactly on an element.
template <int D>
Vec<D> PointEstimator<D>::shifted(const Vec<D>& x, const CagePoint<D>& closest) const {
  const double shift = kFrameShift * settings_.thickness;
  if (closest.distance > kTie * settings_.thickness)
    return closest.point + shift / closest.distance * (x - closest.point);
  // Against the normal as the cage faces on the whole, unless the other side is clearly further inside:
  // a hole whose border runs the way of the outline, a component that faces the other way.
  const Vec<D> normal = cage_.orientation() * element_normal(cage_, cage_.elements()[closest.element], closest.shares);
  const Vec<D> against = closest.point - shift * normal, along = closest.point + shift * normal;
  const bool other_side = std::abs(std::abs(winding_(along)) - 1) + 0.25 < std::abs(std::abs(winding_(against)) - 1);
  return other_side ? along : against;
}

template <int D>
void PointEstimator<D>::project(const Vec<D>& x, const SampleSet<D>& set, Workspace& workspace,
                                Projected<D>& out) const {
  const std::vector<Sample<D>>& samples = set.samples;
  workspace.accumulator.accumulate(samples, Weights::kAsGiven, workspace.moments);
  if (!workspace.moments.is_signed) return projection_.project(workspace.moments, settings_.pseudo_samples, out);
  const auto amplification = projection_.amplification(workspace.moments, x);
  const bool paper = settings_.pseudo_samples == PseudoSamples::kWhenSingular;
  const bool stable = amplification.anywhere <= kSignedAmplificationMaxAnywhere;
  const bool quiet = paper || amplification.at_query <= kSignedAmplificationMax;
  // Pseudo-samples would outweigh what is left of sums of either sign.
  if (stable && quiet)
    return projection_.project(workspace.moments, paper ? PseudoSamples::kWhenSingular : PseudoSamples::kNever, out);
  workspace.accumulator.accumulate(samples, Weights::kMagnitudes, workspace.moments);
  projection_.project(workspace.moments, PseudoSamples::kAlways, out);
  out.singular = true;
}

template <int D>
SampleQuery<D> PointEstimator<D>::locate(const Vec<D>& x, double within, CagePoint<D>& closest,
                                         PointEstimate<D>& out) const {
  closest = distance_.closest(x, within);
  out.flags = 0;
  out.distance = closest.distance;
  out.on_cage.reset();
  const bool tie = closest.distance <= kTie * settings_.thickness;
  if (!tie && !winding_.inside(x)) out.flags |= kRowOutside;
  SampleQuery<D> query{x, closest.distance, QueryRandom(settings_.seed, position_key<D>(x))};
  if (closest.distance < settings_.thickness) {
    out.flags |= kRowOnCage;
    out.on_cage = closest;
    query.origin = shifted(x, closest);
    query.radius = distance_.closest(query.origin).distance;
  }
  return query;
}

template <int D>
bool PointEstimator<D>::estimate(std::span<const Vec<D>> points, const std::atomic<bool>& cancel, Workspace& workspace,
                                 std::span<PointEstimate<D>> out) const {
  workspace.queries.clear();
  // Neighbours in a query set are mostly neighbours in space: what is closest to one is near the next.
  CagePoint<D> closest;
  double within = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < points.size(); ++i) {
    if (i > 0) within = (closest.point - points[i]).norm();
    workspace.queries.push_back(locate(points[i], within, closest, out[i]));
  }
  if (workspace.samples.size() < points.size()) workspace.samples.resize(points.size());
  const bool complete = std::visit(
      [&](const auto& sampler) { return sampler.sample(workspace.queries, cancel, workspace.samples); }, sampler_);
  if (!complete) return false;

  for (size_t i = 0; i < points.size(); ++i) {
    const SampleSet<D>& set = workspace.samples[i];
    PointEstimate<D>& estimate = out[i];
    project(points[i], set, workspace, estimate.projected);
    estimate.counts = set.counts;
    if (set.samples.size() < kSamplesFew) estimate.flags |= kRowFewSamples;
    if (set.samples.empty()) estimate.flags |= kRowNoSamples;
    if (estimate.projected.singular) estimate.flags |= kRowRankDeficient;
    if (estimate.on_cage) projection_.pin(*estimate.on_cage, estimate.projected);
  }
  return true;
}

template class PointEstimator<2>;
template class PointEstimator<3>;

}  // namespace barycast
