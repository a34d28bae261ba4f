// Gradients from first steps: of linear functions exact, of others with the noise that they state.

#include "estimate/first_steps.h"

#include <gtest/gtest.h>

#include <random>

#include "sample/walks.h"

namespace barycast {
namespace {

std::vector<Vec<3>> directions(uint64_t seed, size_t walks) {
  std::vector<Vec<3>> steps(walks);
  first_directions(QueryRandom(seed, 0), steps);
  return steps;
}

TEST(FirstSteps, GiveTheGradientsOfLinearFunctions) {
  for (const size_t walks : {8, 12, 50}) {
    const std::vector<Vec<3>> steps = directions(walks, walks);
    const double radius = 0.03;
    const Vec<3> slope(3, -2, 0.5);
    FirstSteps fit;
    fit.start(steps, radius, 2);
    std::vector<double> sums(2, 0.0);
    for (size_t i = 0; i < walks; ++i) {
      const std::array<double, 2> found = {7 + radius * slope.dot(steps[i]), 1.0};
      fit.add(i, found);
      for (size_t v = 0; v < 2; ++v) sums[v] += found[v];
    }
    std::vector<float> gradients(6);
    EXPECT_NEAR(fit.finish(sums, gradients), 0.0, 1e-9);
    for (int a = 0; a < 3; ++a) {
      EXPECT_NEAR(gradients[static_cast<size_t>(2 * a)], slope[a], 1e-5);
      EXPECT_NEAR(gradients[static_cast<size_t>(2 * a + 1)], 0.0, 1e-9);
    }
  }
}

TEST(FirstSteps, StateTheirNoise) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  for (const size_t walks : {8, 12, 50}) {
    double squared = 0.0, stated = 0.0;
    for (uint64_t trial = 0; trial < 4000; ++trial) {
      FirstSteps fit;
      fit.start(directions(trial, walks), 0.1, 3);
      std::vector<double> sums(3, 0.0);
      for (size_t i = 0; i < walks; ++i) {
        const std::array<double, 3> found = {1 + normal(random), normal(random), 0.1 * normal(random)};
        fit.add(i, found);
        for (size_t v = 0; v < 3; ++v) sums[v] += found[v];
      }
      std::vector<float> gradients(9);
      stated += fit.finish(sums, gradients);
      for (const float value : gradients) squared += double{value} * double{value};
    }
    EXPECT_NEAR(squared / stated, 1.0, 0.05) << walks;
  }
}

}  // namespace
}  // namespace barycast
