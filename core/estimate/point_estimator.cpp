#include "estimate/point_estimator.h"

#include "base/tolerances.h"

namespace barycast {
template <int D>
PointEstimator<D>::PointEstimator(const Cage<D>& cage, const DistanceIndex<D>& distance,
                                  const WindingNumber<D>& winding, Sampler<D> sampler, const Settings& settings)
    : locator_(cage, distance, winding, settings.thickness, settings.closed),
      sampler_(std::move(sampler)),
      settings_(settings),
      projection_(cage) {}

template <int D>
void PointEstimator<D>::project(const Vec<D>& x, const SampleSet<D>& set, Workspace& workspace,
                                Projected<D>& out) const {
  const std::vector<Sample<D>>& samples = set.samples;
  workspace.accumulator.accumulate(samples, Weights::kAsGiven, workspace.moments);
  if (!workspace.moments.is_signed) return projection_.project(workspace.moments, settings_.pseudo_samples, out);
  const bool paper = settings_.pseudo_samples == PseudoSamples::kWhenSingular;
  if (!paper && projection_.amplify_less(workspace.moments, kSignedAmplificationMax))
    return projection_.project(workspace.moments, PseudoSamples::kNever, out);
  const auto amplification = projection_.amplification(workspace.moments, x);
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
bool PointEstimator<D>::estimate(std::span<const Vec<D>> points, const std::atomic<bool>& cancel, Workspace& workspace,
                                 std::span<PointEstimate<D>> out) const {
  locator_.locate(points, settings_.seed, workspace.queries, out);
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
