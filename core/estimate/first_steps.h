#pragma once

// The gradient of the mean of what walks find, from their first steps. A walk from x jumps first to x + R n, n uniform
// over all directions; with u(y) the mean of what walks from y find, a harmonic function,
//
//   E[found | n] = u(x + R n) = u(x) + R n . grad u(x) + harmonics of degree two and more in n,
//
// which are orthogonal to both: grad u(x) is the slope of least squares over the directions. Where they surround x
// evenly, as a lattice does, that is the mean value property (3 / R) mean[n found], but exact for linear functions.
// Its noise grows like 1 / R.

#include <cstddef>
#include <span>
#include <vector>

#include "base/vector.h"

namespace barycast {

// One point's walks after another's. Not thread-safe.
class FirstSteps {
 public:
  // Slopes of fewer walks say nothing of their noise.
  static constexpr size_t kWalksLeast = 8;

  // Before the walks of a point: the directions of their first steps, R, and how many functions they find the means of.
  void start(std::span<const Vec<3>> directions, double radius, size_t functions);
  // What walk i found, a number for each function.
  void add(size_t i, std::span<const double> found);
  // With the sums of what they found, by function: writes the gradients of the means, all first partial derivatives
  // before the second and the third. Returns the mean of the squared length of their noise, all functions together.
  double finish(std::span<const double> sums, std::span<float> gradients) const;

 private:
  std::vector<Vec<3>> weights_;  // of what each walk found
  Eigen::Matrix3d covariance_;   // of the directions
  double radius_;
  std::vector<double> squares_;  // of what was found, by function
  std::vector<double> slopes_;   // 3 x functions
};

}  // namespace barycast
