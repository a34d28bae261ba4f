#pragma once

// How noisy estimates are, measured by estimating some points again with other seeds.

#include <atomic>
#include <optional>
#include <span>

#include "estimate/point_estimator.h"

namespace barycast {

// The standard deviation of the coordinates of a point between independent randomizations, in units of what a single
// sample deviates from the linear fit: 1 / sqrt(m) for m independent samples, less for lattices and for walks that
// cover the cage evenly. The median over some of the points, up to 48, the same whatever their order; those on the
// cage, and those with few samples, do not count: where no other is left, or of less than 64 points, 1 / sqrt(samples).
// Costs a sixteenth of the estimates of all points, a quarter where they are few, on the threads of the arena. Nothing:
// `cancel` was seen set.
template <int D>
std::optional<double> relative_noise(const PointEstimator<D>& estimator, const Cage<D>& cage,
                                     std::span<const Vec<D>> points, uint32_t samples, const std::atomic<bool>& cancel);

extern template std::optional<double> relative_noise(const PointEstimator<2>&, const Cage<2>&, std::span<const Vec<2>>,
                                                     uint32_t, const std::atomic<bool>&);
extern template std::optional<double> relative_noise(const PointEstimator<3>&, const Cage<3>&, std::span<const Vec<3>>,
                                                     uint32_t, const std::atomic<bool>&);

}  // namespace barycast
