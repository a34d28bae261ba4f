#pragma once

// What every sampling strategy produces: weighted points of the cage [SBC 4.3]. A strategy is one file
// of this folder with one class, which fills a SampleSet for each of some query points; it is chosen once
// per binding (a variant), never per sample. How many points come together changes nothing but speed.

#include <array>
#include <cstdint>
#include <vector>

#include "base/random.h"
#include "base/vector.h"

namespace barycast {

// A query point as strategies see it.
template <int D>
struct SampleQuery {
  Vec<D> origin;  // not on the cage
  double radius;  // around it, free of the cage
  QueryRandom random;
  uint32_t walks = 0;  // other than settings say; 0: as many as those
};

enum class SampleEnd : uint8_t {
  kArrived,  // within the thickness of the cage
  kCapped,   // at the step limit; the sample is the closest point of the cage
  kHit,      // where a ray meets the cage
};

template <int D>
struct Sample {
  Vec<D> point;                  // y_k, on the cage
  double weight;                 // w_k
  std::array<double, 4> shares;  // of the element's corners; they give phi_v(y_k)
  uint32_t element;
  SampleEnd end;
};

struct SampleCounts {
  uint64_t started = 0;    // walks or rays
  uint64_t steps = 0;      // of walks
  uint64_t capped = 0;     // walks that ended at the step limit
  uint64_t discarded = 0;  // walks that were dropped at the step limit or far away
  uint64_t reentries = 0;  // through the enclosing sphere

  SampleCounts& operator+=(const SampleCounts& other) {
    started += other.started;
    steps += other.steps;
    capped += other.capped;
    discarded += other.discarded;
    reentries += other.reentries;
    return *this;
  }
};

template <int D>
struct SampleSet {
  std::vector<Sample<D>> samples;  // in the order of walks or rays
  SampleCounts counts;
  void clear() {
    samples.clear();
    counts = {};
  }
};

}  // namespace barycast
