#include "sample/walks.h"

#include <array>
#include <cmath>

#include "base/tolerances.h"
#include "sample/directions.h"

namespace barycast {
namespace {

// Walks advance together in batches, so that a distance engine sees many points at once; the size
// changes nothing but speed.
constexpr uint32_t kBatch = 64;
// Without re-entry a walk this far out comes back with a probability of 1e-6: it is discarded.
constexpr double kEscapeRadius = 1e6;

}  // namespace

template <int D>
struct HarmonicWalks<D>::Batch {
  uint32_t first_walk = 0;
  uint32_t active = 0;  // the walks still under way are the first `active` of the arrays below
  std::array<Vec<D>, kBatch> position;
  std::array<double, kBatch> radius;  // free of the cage; 0: not known yet
  std::array<double, kBatch> weight;
  std::array<uint32_t, kBatch> hint;
  std::array<uint32_t, kBatch> steps;
  std::array<uint32_t, kBatch> slot;       // the walk's index in the batch
  std::array<Sample<D>, kBatch> sample;    // by slot
  std::array<bool, kBatch> ended_on_cage;  // by slot

  void start(uint32_t first, uint32_t count, const Vec<D>& origin, double origin_radius) {
    first_walk = first;
    active = count;
    for (uint32_t i = 0; i < count; ++i) {
      position[i] = origin;
      radius[i] = origin_radius;
      weight[i] = 1.0;
      hint[i] = kNoHint;
      steps[i] = 0;
      slot[i] = i;
      ended_on_cage[i] = false;
    }
  }
  void end(uint32_t i, const CagePoint<D>& at, SampleEnd how) {
    sample[slot[i]] = {at.point, weight[i], at.shares, at.element, how};
    ended_on_cage[slot[i]] = true;
    remove(i);
  }
  void remove(uint32_t i) {
    --active;
    position[i] = position[active];
    radius[i] = radius[active];
    weight[i] = weight[active];
    hint[i] = hint[active];
    steps[i] = steps[active];
    slot[i] = slot[active];
  }
};

template <int D>
void HarmonicWalks<D>::step(Batch& batch, const QueryRandom& random, SampleCounts& counts) const {
  // Numbers and directions of all walks in plain loops, which the compiler turns into vector code.
  std::array<std::array<double, 2>, kBatch> numbers;
  std::array<Vec<D>, kBatch> direction;
  for (uint32_t i = 0; i < batch.active; ++i)
    numbers[i] = random.pair(batch.first_walk + batch.slot[i], batch.steps[i]);
  for (uint32_t i = 0; i < batch.active; ++i) direction[i] = uniform_direction<D>(numbers[i]);

  for (uint32_t i = 0; i < batch.active; ++i) {
    ++batch.steps[i];
    Vec<D>& position = batch.position[i];
    const double distance = position.norm();
    if (settings_.run_on && distance > kReentryRadius) {
      position = exterior_hit(position, kEnclosingRadius, numbers[i]);
      // In the plane Brownian motion comes back with certainty, in space with this probability.
      if constexpr (D == 3) batch.weight[i] *= kEnclosingRadius / distance;
      batch.hint[i] = kNoHint;
      ++counts.reentries;
    } else {
      position += batch.radius[i] * direction[i];
    }
  }
  counts.steps += batch.active;
  distance_.free_radii({batch.position.data(), batch.active}, {batch.hint.data(), batch.active},
                       {batch.radius.data(), batch.active});
}

// Ends the walks that arrived or reached the step limit.
template <int D>
void HarmonicWalks<D>::settle(Batch& batch, SampleCounts& counts) const {
  for (uint32_t i = 0; i < batch.active;) {
    // A free radius never exceeds the distance: only below the thickness may the walk have arrived.
    if (batch.radius[i] < settings_.thickness) {
      const CagePoint<D> closest = distance_.closest(batch.position[i]);
      if (closest.distance < settings_.thickness) {
        batch.end(i, closest, SampleEnd::kArrived);
        continue;
      }
      batch.radius[i] = closest.distance;
    }
    if (batch.steps[i] >= settings_.walk_steps_max) {
      if (settings_.run_on) {
        ++counts.capped;
        batch.end(i, distance_.closest(batch.position[i]), SampleEnd::kCapped);
      } else {
        ++counts.discarded;
        batch.remove(i);
      }
      continue;
    }
    if (!settings_.run_on && batch.position[i].squaredNorm() > kEscapeRadius * kEscapeRadius) {
      ++counts.discarded;
      batch.remove(i);
      continue;
    }
    ++i;
  }
}

template <int D>
bool HarmonicWalks<D>::sample(const Vec<D>& origin, double origin_radius, const QueryRandom& random,
                              const std::atomic<bool>& cancel, SampleSet<D>& out) const {
  out.clear();
  out.counts.started = settings_.walks;
  Batch batch;
  for (uint32_t first = 0; first < settings_.walks; first += kBatch) {
    const uint32_t count = std::min(kBatch, settings_.walks - first);
    batch.start(first, count, origin, origin_radius);
    while (batch.active > 0) {
      if (cancel.load(std::memory_order_relaxed)) return false;
      step(batch, random, out.counts);
      settle(batch, out.counts);
    }
    for (uint32_t slot = 0; slot < count; ++slot)
      if (batch.ended_on_cage[slot]) out.samples.push_back(batch.sample[slot]);
  }
  return true;
}

template class HarmonicWalks<2>;
template class HarmonicWalks<3>;

}  // namespace barycast
