#pragma once

// Mean value [SBC 5.2; Ju et al. 2005] and positive mean value coordinates [SBC 5.3; Lipman et al. 2007] by
// rays: every hit of a ray is a sample, with the reciprocal of its distance as weight, signs alternating
// from the query outwards; for the positive kind only what is visible counts.
//
// As printed, directions are independent. Otherwise whole lines are cast, two rays each, over a randomly
// rotated Fibonacci lattice: the error falls like 1/m instead of 1/sqrt(m). From outside the cage's
// enclosing sphere rays keep to the cone that it fills.
// Cost: one line query per two rays (per ray outside). Const and thread-safe.

#include <atomic>
#include <span>
#include <vector>

#include "base/random.h"
#include "query/line_index.h"
#include "sample/sample.h"

namespace barycast {

struct RaySettings {
  uint32_t rays = 50;         // lines come in whole: an odd number is rounded up, unless as_printed
  bool visible_only = false;  // positive mean value
  // Independent rays within the cone of the bounding box, until there are as many samples or rays as
  // `rays` says.
  bool as_printed = false;
};

template <int D>
class RaySamples {
 public:
  RaySamples(const Cage<D>& cage, const LineIndex<D>& lines, const RaySettings& settings);

  // Fills `out` with the samples of each query, ray by ray, outwards. Distances are measured from its origin.
  // False: `cancel` was seen set, and `out` is incomplete.
  bool sample(std::span<const SampleQuery<D>> queries, const std::atomic<bool>& cancel,
              std::span<SampleSet<D>> out) const;

 private:
  // Memory that queries share.
  struct Workspace {
    std::vector<Vec<D>> directions;
    LineHits<D> hits;
  };

  bool sample_lattice(const Vec<D>& origin, const QueryRandom& random, const std::atomic<bool>& cancel,
                      Workspace& workspace, SampleSet<D>& out) const;
  bool sample_as_printed(const Vec<D>& origin, const QueryRandom& random, const std::atomic<bool>& cancel,
                         Workspace& workspace, SampleSet<D>& out) const;
  // The hits of one ray, in the order outwards.
  template <class Iterator>
  void add_ray(const Vec<D>& origin, const LineHits<D>& hits, Iterator nearest, Iterator end, SampleSet<D>& out) const;
  // The lattice's lines, before any rotation.
  uint32_t line_count() const { return (settings_.rays + 1) / 2; }
  Vec<D> lattice_direction(uint32_t line) const;

  const LineIndex<D>& lines_;
  RaySettings settings_;
  Vec<D> box_low_, box_high_;
  std::vector<Vec<D>> lattice_;  // the first of its directions
};

extern template class RaySamples<2>;
extern template class RaySamples<3>;

}  // namespace barycast
