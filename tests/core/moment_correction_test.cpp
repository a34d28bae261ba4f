#include "estimate/moment_correction.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "solve/panels.h"
#include "support/shapes.h"

namespace barycast {
namespace {

using Row = BoundaryData::Row;

const Vec<3> kPoint(0.1, -0.2, 0.5);

// A measure on a box, most of it on two faces.
struct Measure {
  const Cage<3> cage = Cage<3>::create(testing::small_box(1.0, 0.6, 0.8).input()).value();
  const BoundaryData data{cage, true};
  std::mt19937 generator{5};

  // Of some samples, in the mean.
  Row moments(size_t samples) {
    std::uniform_real_distribution<double> uniform;
    Row sum = Row::Zero(data.count()), one(data.count());
    for (size_t i = 0; i < samples; ++i) {
      const auto element = static_cast<uint32_t>((uniform(generator) < 0.7 ? 2 : 6) * uniform(generator));
      const double u = uniform(generator), v = uniform(generator);
      const std::array<double, 4> shares = {(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v};
      data.values(element, shares, point_at(cage, cage.elements()[element], shares), one);
      sum += one;
    }
    return sum / static_cast<double>(samples);
  }
  Row projected(const Row& moments) const {
    Row values(data.basis_count());
    MomentProjection(data, kPoint, moments).values(values);
    return values;
  }
};

std::vector<float> floats(const Row& row) {
  std::vector<float> out(static_cast<size_t>(row.size()));
  for (size_t i = 0; i < out.size(); ++i) out[i] = static_cast<float>(row[static_cast<Eigen::Index>(i)]);
  return out;
}

TEST(MomentProjection, ChangesAsItsDerivativeSays) {
  Measure measure;
  const Row moments = measure.moments(500), toward = measure.moments(500) - moments;
  constexpr double kStep = 1e-4;
  Row change(measure.data.basis_count());
  MomentProjection(measure.data, kPoint, moments).change(Vec<3>::Zero(), toward, change);
  const Row difference =
      (measure.projected(moments + kStep * toward) - measure.projected(moments - kStep * toward)) / (2 * kStep);
  EXPECT_LT((change - difference).norm(), 1e-6 * change.norm());
  EXPECT_GT(change.norm(), 1e-3);
}

TEST(MomentCorrection, CompletesAnyPrediction) {
  Measure measure;
  const Row moments = measure.moments(1000), other = 0.9 * measure.moments(20);
  const MomentCorrection correction(measure.data, kPoint, other);
  std::vector<float> found(8);
  ASSERT_EQ(correction.correct(floats(moments - other), found), MomentCorrection::Outcome::kCorrected);
  const Row exact = measure.projected(moments), predicted = measure.projected(other);
  for (Eigen::Index v = 0; v < 8; ++v)
    EXPECT_NEAR(predicted[v] + double{found[static_cast<size_t>(v)]}, exact[v], 1e-5);
}

TEST(MomentCorrection, IsNoneWhereWalksLeaveNoMass) {
  Measure measure;
  const Row predicted = measure.moments(1000);
  const MomentCorrection correction(measure.data, kPoint, predicted);
  std::vector<float> found(8, 1.0f);
  EXPECT_EQ(correction.correct(floats(-0.6 * predicted), found), MomentCorrection::Outcome::kLittleMass);
  for (const float value : found) EXPECT_EQ(value, 0.0f);
}

// Of a few samples the projection is far from linear: the mean of twelve samples' coordinates is off by what all
// samples together are not, and not by noise.
TEST(MomentCorrection, SaysHowFarAllRandomizationsTogetherAreOff) {
  Measure measure;
  const Row predicted = measure.moments(100), exact = measure.projected(measure.moments(2'000'000));
  const MomentCorrection correction(measure.data, kPoint, predicted);
  const Row exact_correction = exact - measure.projected(predicted);
  for (const size_t rounds : {8, 64, 512}) {
    const int trials = rounds == 512 ? 400 : 2000;
    double within = 0.0, squared = 0.0, stated = 0.0;
    Randomizations missing;
    std::vector<float> mean(38), found(8);
    for (int t = 0; t < trials; ++t) {
      missing.clear(38);
      for (size_t r = 0; r < rounds; ++r) missing.add(floats(measure.moments(12) - predicted));
      missing.mean(mean);
      ASSERT_EQ(correction.correct(mean, found), MomentCorrection::Outcome::kCorrected);
      double off = 0.0;
      for (size_t v = 0; v < found.size(); ++v)
        off += std::pow(double{found[v]} - exact_correction[static_cast<Eigen::Index>(v)], 2);
      const Randomizations::Error error = correction.error(missing);
      within += std::sqrt(off) <= error.at_95;
      squared += off;
      stated += error.standard * error.standard;
    }
    EXPECT_NEAR(within / trials, 0.95, 0.02 + 3 * std::sqrt(0.95 * 0.05 / trials)) << rounds;
    EXPECT_NEAR(squared / stated, 1.0, 0.1 + 4 / std::sqrt(trials)) << rounds;
  }
}

}  // namespace
}  // namespace barycast
