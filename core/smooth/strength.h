#pragma once

// How long the heat of the denoising flows, in squared diagonals of the cage: the longer, the less noise and
// the more bias. From the lengths of the query mesh's edges and the number of samples, so that it can be known before
// any work is done; and, for a node near the cage, from its distance.

#include <algorithm>
#include <atomic>
#include <optional>
#include <vector>

#include "smooth/laplacian.h"

namespace barycast {

// Over the mesh's edges, each once; edges between coincident points do not count. 0 when there are none.
struct SquaredEdges {
  double mean = 0.0, median = 0.0;
};

// Linear. Nothing: `cancel` was seen set.
std::optional<SquaredEdges> squared_edges(const QueryMesh& mesh, const std::atomic<bool>& cancel);

// The paper's rule: the mean squared edge times s(m) = max(1, 5 - log10 m) [SBC 4.4].
double smoothing_time_as_printed(const SquaredEdges& edges, double samples);

// How an estimate's error falls with the number m of its samples.
enum class ErrorRate {
  kSquareRoot,  // like 1 / sqrt(m): independent walks
  kLinear,      // like 1 / m: lattices of rays
};

// The rule of the default preset. relative_noise: as measured (estimate/noise.h), 1 / sqrt(m) for m independent
// samples. Over time t the bias grows like t, and the noise falls in proportion to sqrt(h^2 / t) where t is longer than
// a squared edge h^2, and to 1 - t / h^2 where it is shorter: the best time goes with the noise, less than in
// proportion where that is large. differs from [SBC 4.4]: the median of the squared edges, for a few long edges, of a
// ground plane or of a coarse part, must not blur all the others; and less smoothing where there is less noise. E at m
// = 50 on FireHydrant, whose mean is 6 times its median: harmonic 0.0402 -> 0.0197, mean value 0.0522 -> 0.0098.
double smoothing_time(const SquaredEdges& edges, double relative_noise);

// Of the corrections of a prediction, which are small and smooth. Twelve walks, FireHydrant: E .0066 without, .0017
// with 4 times the median squared edge, .0016 with 20 times it.
double smoothing_time_of_corrections(const SquaredEdges& edges);

// Times a node's squared distance from the cage, the longest time that serves it: coordinates change over lengths like
// the distance, and the kernel must hardly reach further.
// differs from [SBC 4.4]: one time for all blurs what is near the cage, where there is little noise. E at m = 50 on
// FireHydrant's cage moved inwards by 0.0025: harmonic 0.1828 -> 0.0162, mean value 0.0852 -> 0.0023.
double smoothing_time_per_squared_distance(ErrorRate rate, double samples);

// The times of nodes: the longest, or what their distances from the cage, distance_of(node), allow. least: what a
// distance counts as at least.
template <class Distance>
std::vector<double> smoothing_times(size_t nodes, double longest, double per_squared_distance, double least,
                                    const Distance& distance_of) {
  std::vector<double> times(nodes);
  for (size_t node = 0; node < nodes; ++node) {
    const double distance = std::max(distance_of(node), least);
    times[node] = std::min(longest, per_squared_distance * distance * distance);
  }
  return times;
}

}  // namespace barycast
