#include "estimate/moment_correction.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace barycast {
namespace {

constexpr Eigen::Index kVertices = 8, kColumns = 4 * kVertices + 6;
using Row = BoundaryData::Row;

// Of a measure on the unit cube about the origin, more of it above: some samples' mean moments.
class Measure {
 public:
  Row moments(size_t samples) {
    Row sum = Row::Zero(kColumns);
    for (size_t i = 0; i < samples; ++i) {
      const Vec<3> y = sample();
      for (int v = 0; v < kVertices; ++v) {
        double phi = 1.0;
        for (int a = 0; a < 3; ++a) phi *= 0.5 + ((v >> a & 1) != 0 ? y[a] : -y[a]);
        sum[v] += phi;
        sum.segment<3>(kVertices + 3 * v) += phi * y.transpose();
      }
      Eigen::Index c = 4 * kVertices;
      for (int a = 0; a < 3; ++a)
        for (int b = a; b < 3; ++b) sum[c++] += y[a] * y[b];
    }
    return sum / static_cast<double>(samples);
  }

 private:
  Vec<3> sample() {
    Vec<3> y;
    for (int a = 0; a < 3; ++a) y[a] = uniform_(generator_) - 0.5;
    const int axis = uniform_(generator_) < 0.5 ? 2 : static_cast<int>(3 * uniform_(generator_));
    y[axis] = uniform_(generator_) < 0.7 ? 0.5 : -0.5;
    return y;
  }
  std::mt19937 generator_{5};
  std::uniform_real_distribution<double> uniform_;
};

const Vec<3> kPoint(0.1, -0.2, 0.8);

Row projected(const Row& moments) {
  Row values(kVertices);
  MomentProjection(kPoint, moments, kVertices).values(values);
  return values;
}

std::vector<float> floats(const Row& row) {
  std::vector<float> out(static_cast<size_t>(row.size()));
  for (size_t i = 0; i < out.size(); ++i) out[i] = static_cast<float>(row[static_cast<Eigen::Index>(i)]);
  return out;
}

TEST(MomentProjection, ChangesAsItsDerivativeSays) {
  Measure measure;
  const Row moments = measure.moments(500), toward = measure.moments(500) - moments;
  constexpr double kStep = 1e-4;
  Row change(kVertices);
  MomentProjection(kPoint, moments, kVertices).change(Vec<3>::Zero(), toward, change);
  const Row difference = (projected(moments + kStep * toward) - projected(moments - kStep * toward)) / (2 * kStep);
  EXPECT_LT((change - difference).norm(), 1e-6 * change.norm());
  EXPECT_GT(change.norm(), 1e-3);
}

TEST(MomentCorrection, CompletesAnyPrediction) {
  Measure measure;
  const Row moments = measure.moments(1000), other = 0.9 * measure.moments(20);
  const MomentCorrection correction(kPoint, other, kVertices);
  std::vector<float> found(kVertices);
  ASSERT_TRUE(correction.correct(floats(moments - other), found));
  const Row exact = projected(moments), predicted = projected(other);
  for (Eigen::Index v = 0; v < kVertices; ++v)
    EXPECT_NEAR(predicted[v] + double{found[static_cast<size_t>(v)]}, exact[v], 1e-5);
}

TEST(MomentCorrection, IsNoneWhereWalksLeaveNoMass) {
  Measure measure;
  const Row predicted = measure.moments(1000);
  const MomentCorrection correction(kPoint, predicted, kVertices);
  std::vector<float> found(kVertices, 1.0f);
  EXPECT_FALSE(correction.correct(floats(-0.6 * predicted), found));
  for (const float value : found) EXPECT_EQ(value, 0.0f);
}

// Of a few samples the projection is far from linear: the mean of twelve samples' coordinates is off by what all
// samples together are not, and not by noise.
TEST(MomentCorrection, SaysHowFarAllRandomizationsTogetherAreOff) {
  Measure measure;
  const Row predicted = measure.moments(100), exact = projected(measure.moments(2'000'000));
  const MomentCorrection correction(kPoint, predicted, kVertices);
  const Row exact_correction = exact - projected(predicted);
  for (const size_t rounds : {8, 64, 512}) {
    const int trials = rounds == 512 ? 400 : 2000;
    double within = 0.0, squared = 0.0, stated = 0.0;
    Randomizations missing;
    std::vector<float> mean(kColumns), found(kVertices);
    for (int t = 0; t < trials; ++t) {
      missing.clear(kColumns);
      for (size_t r = 0; r < rounds; ++r) missing.add(floats(measure.moments(12) - predicted));
      missing.mean(mean);
      ASSERT_TRUE(correction.correct(mean, found));
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
