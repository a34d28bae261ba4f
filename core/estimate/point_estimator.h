#pragma once

// Query points, from position to linear fits: closest point, samples, moments, projection. The
// sampling strategy is a closed set, chosen once per binding; a new kind of coordinates is one more
// alternative here and one file in `sample`.

#include <atomic>
#include <cstdint>
#include <span>
#include <variant>

#include "estimate/locator.h"
#include "estimate/moments.h"
#include "estimate/projection.h"
#include "sample/rays.h"
#include "sample/walks.h"

namespace barycast {

template <int D>
using Sampler = std::variant<HarmonicWalks<D>, RaySamples<D>>;

template <int D>
struct PointEstimate : Located<D> {
  Projected<D> projected;
  SampleCounts counts;
};

template <int D>
class PointEstimator {
 public:
  struct Settings {
    double thickness;
    uint64_t seed;
    PseudoSamples pseudo_samples;  // for positive weights
    bool closed = false;           // whether the cage is known to bound a volume: saves time
  };
  PointEstimator(const Cage<D>& cage, const DistanceIndex<D>& distance, const WindingNumber<D>& winding,
                 Sampler<D> sampler, const Settings& settings);

  // The same with other random numbers, for every r from 1 on.
  PointEstimator randomized(uint64_t r) const {
    PointEstimator other(*this);
    other.settings_.seed = barycast::randomized(settings_.seed, r);
    return other;
  }

  // Memory that one task reuses from points to points.
  struct Workspace {
    explicit Workspace(const Cage<D>& cage) : accumulator(cage) {}
    MomentAccumulator<D> accumulator;
    Moments<D> moments;
    std::vector<SampleQuery<D>> queries;
    std::vector<SampleSet<D>> samples;
  };

  // Estimates of some points (normalized frame): each a function of its position, the seed and the settings alone;
  // samplers are faster on many. False: `cancel` was seen set. Const and thread-safe, a workspace per thread.
  bool estimate(std::span<const Vec<D>> points, const std::atomic<bool>& cancel, Workspace& workspace,
                std::span<PointEstimate<D>> out) const;

  const Projection<D>& projection() const { return projection_; }

 private:
  // Signed weights do without pseudo-samples; where they amplify noise too much (in the paper preset: where rounding
  // would be seen), their magnitudes with pseudo-samples replace them.
  void project(const Vec<D>& x, const SampleSet<D>& samples, Workspace& workspace, Projected<D>& out) const;

  Locator<D> locator_;
  Sampler<D> sampler_;
  Settings settings_;
  Projection<D> projection_;
};

extern template class PointEstimator<2>;
extern template class PointEstimator<3>;

}  // namespace barycast
