// What can only be tested as statistics: the rate of convergence, equivariance, and where the estimate
// converges to. Seeds are fixed, so a test that passes passes always.

#include <gtest/gtest.h>

#include "estimate/noise.h"
#include "estimate/point_estimator.h"
#include "estimate/row.h"
#include "support/rows.h"

namespace barycast {
namespace {

using testing::Shape;

// A distance index that sends a part of the walks to a corner of the cage, whatever they came near to.
class WrongIndex final : public DistanceIndex<3> {
 public:
  WrongIndex(const Cage<3>& cage, const DistanceIndex<3>& right, double part)
      : cage_(cage), right_(right), part_(part) {}
  CagePoint<3> closest(const Vec<3>& x, double within) const override { return right_.closest(x, within); }
  void near(const WalkPositions& at, std::span<const uint32_t> walks, double tolerance,
            std::span<CagePoint<3>> ends) const override {
    right_.near(at, walks, tolerance, ends);
    for (size_t k = 0; k < walks.size(); ++k) {
      // Which walks: by the digits of their last position, which are as good as random.
      const double digits = std::abs(position_of<3>(at, walks[k]).sum()) * 1e7;
      if (digits - std::floor(digits) >= part_) continue;
      ends[k].element = 0;
      ends[k].shares = {1, 0, 0, 0};
      ends[k].point = cage_.corner(cage_.elements()[0], 0);
    }
  }
  void free_radii(const WalkPositions& at, uint32_t* hints, float* radii) const override {
    right_.free_radii(at, hints, radii);
  }
  double free_radius(const Vec<3>& x) const override { return right_.free_radius(x); }
  size_t bytes() const override { return right_.bytes(); }

 private:
  const Cage<3>& cage_;
  const DistanceIndex<3>& right_;
  double part_;
};

// Root mean square error with so many samples, in a box, where the answer is trilinear. A thin cage, so that its bias
// stays below the noise at the most samples.
double box_error(const CageStructures<3>& structures, const DistanceIndex<3>& distance, uint32_t samples,
                 bool independent) {
  const RowFinisher<3> finisher(structures.cage, {.prune_below = 0.0, .gradients = false});
  const auto points = testing::random_points(40, 3, -0.8, 0.8, 17);
  const std::atomic<bool> never = false;
  PointEstimator<3>::Workspace workspace(structures.cage);
  const HarmonicWalks<3> walks(distance, {.walks = samples, .thickness = 1e-4, .as_printed = independent});
  const PointEstimator<3> estimator(structures.cage, distance, *structures.winding, walks,
                                    {.thickness = 1e-4, .seed = samples, .pseudo_samples = PseudoSamples::kAlways});
  std::vector<Vec<3>> normalized;
  for (size_t i = 0; i < 40; ++i)
    normalized.push_back(structures.cage.frame().to_normalized(Eigen::Map<const Vec<3>>(points.data() + 3 * i)));
  std::vector<PointEstimate<3>> estimates(normalized.size());
  EXPECT_TRUE(estimator.estimate(normalized, never, workspace, estimates));
  double squared = 0.0;
  for (size_t i = 0; i < 40; ++i) {
    const Vec<3> x = Eigen::Map<const Vec<3>>(points.data() + 3 * i);
    std::vector<RowEntry<3>> row;
    finisher.evaluate(estimates[i].projected, normalized[i], row);
    finisher.finish(normalized[i], row);
    for (const auto& entry : row) {
      const double sx = (entry.vertex & 4) != 0 ? 1 : -1, sy = (entry.vertex & 2) != 0 ? 1 : -1,
                   sz = (entry.vertex & 1) != 0 ? 1 : -1;
      squared += std::pow(entry.value - (1 + sx * x[0]) * (1 + sy * x[1]) * (1 + sz * x[2]) / 8, 2);
    }
  }
  return std::sqrt(squared / 40);
}

// Slope of log error against log m.
double error_slope(bool independent, double wrong_part) {
  const auto index = testing::make_index(testing::box());
  const auto& structures = *std::get<std::unique_ptr<const CageStructures<3>>>(index->structures());
  const WrongIndex distance(structures.cage, *structures.walks, wrong_part);
  std::vector<double> log_m, log_error;
  for (const uint32_t samples : {32u, 128u, 512u, 2048u, 8192u}) {
    log_m.push_back(std::log(samples));
    log_error.push_back(std::log(box_error(structures, distance, samples, independent)));
  }
  double sxy = 0.0, sxx = 0.0, mx = 0.0, my = 0.0;
  for (size_t i = 0; i < log_m.size(); ++i) {
    mx += log_m[i] / double(log_m.size());
    my += log_error[i] / double(log_m.size());
  }
  for (size_t i = 0; i < log_m.size(); ++i) {
    sxy += (log_m[i] - mx) * (log_error[i] - my);
    sxx += (log_m[i] - mx) * (log_m[i] - mx);
  }
  return sxy / sxx;
}

TEST(Rate, ErrorOfIndependentWalksFallsWithTheSquareRootOfTheSamples) {
  EXPECT_NEAR(error_slope(true, 0.0), -0.5, 0.05);
}

TEST(Rate, TwoPercentOfWrongWalksFailTheTest) {
  EXPECT_GT(error_slope(true, 0.02), -0.45);
}

// Walks that take their directions from a lattice, in their order along a curve, gain more the more there are.
TEST(Rate, ErrorOfOrderedWalksFallsFaster) {
  EXPECT_LT(error_slope(false, 0.0), -0.55);
}

TEST(Rate, OrderedWalksHaveLessErrorThanIndependentOnes) {
  const auto index = testing::make_index(testing::box());
  const auto& structures = *std::get<std::unique_ptr<const CageStructures<3>>>(index->structures());
  for (const uint32_t samples : {50u, 500u, 5000u}) {
    const double ratio = box_error(structures, *structures.walks, samples, false) /
                         box_error(structures, *structures.walks, samples, true);
    EXPECT_LT(ratio, samples == 50 ? 0.95 : 0.8);
  }
}

// Means over seeds of every coordinate of every point, and their variances.
struct Means {
  std::vector<double> mean, variance;
};

Means means_over_seeds(const Shape& shape, const std::vector<double>& points, uint64_t first_seed) {
  const auto index = testing::make_index(shape);
  constexpr int kSeeds = 60;
  const size_t columns = index->control_vertex_count(), rows = points.size() / 3;
  Means result{std::vector<double>(rows * columns, 0.0), std::vector<double>(rows * columns, 0.0)};
  std::vector<double> squares(rows * columns, 0.0);
  for (int s = 0; s < kSeeds; ++s) {
    Options options;
    options.estimator = Estimator::kSampling;
    options.seed = first_seed + static_cast<uint64_t>(s);
    options.prune_below = 0.0;
    const RowBlock block = testing::bind_or_die(index, testing::loose_points(points), options);
    for (size_t i = 0; i < rows; ++i) {
      const auto row = testing::dense_row(block, i, columns);
      for (size_t v = 0; v < columns; ++v) {
        result.mean[i * columns + v] += row[v] / kSeeds;
        squares[i * columns + v] += row[v] * row[v] / kSeeds;
      }
    }
  }
  for (size_t k = 0; k < squares.size(); ++k)
    result.variance[k] = (squares[k] - result.mean[k] * result.mean[k]) / (kSeeds - 1);
  return result;
}

// Largest two-sample z over all coordinates, after mapping columns.
double largest_z(const Means& a, const Means& b, const std::vector<uint32_t>& column_of_b) {
  double worst = 0.0;
  const size_t columns = column_of_b.size();
  for (size_t k = 0; k < a.mean.size(); ++k) {
    const size_t other = k / columns * columns + column_of_b[k % columns];
    const double error = std::sqrt(a.variance[k] + b.variance[other] + 1e-20);
    worst = std::max(worst, std::abs(a.mean[k] - b.mean[other]) / error);
  }
  return worst;
}

// 20 points x 16 vertices: a family of 320 z values stays below this with a probability of 99 % (Student
// with 59 degrees of freedom twice).
constexpr double kFamilyZ = 4.5;

TEST(Equivariance, UnderRotationAndTranslation) {
  const Shape shape = testing::bent_prism();
  const Eigen::Matrix3d rotation = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  const auto move = [&](const Eigen::VectorXd& x) { return Eigen::VectorXd(rotation * x + Eigen::Vector3d(3, -2, 1)); };
  // Half of them outside.
  const auto points = testing::random_points(20, 3, -0.5, 2.5, 23);
  std::vector<double> moved;
  for (size_t i = 0; i < 20; ++i) {
    const Eigen::VectorXd y = move(Eigen::Map<const Eigen::Vector3d>(points.data() + 3 * i));
    moved.insert(moved.end(), y.data(), y.data() + 3);
  }
  std::vector<uint32_t> same(16);
  for (uint32_t v = 0; v < 16; ++v) same[v] = v;
  const Means here = means_over_seeds(shape, points, 1);
  EXPECT_LT(largest_z(here, means_over_seeds(shape.mapped(move), moved, 1000), same), kFamilyZ);
  // The statistic sees a wrong answer: the same coordinates a tenth of a unit away.
  std::vector<double> shifted = points;
  for (double& value : shifted) value += 0.1;
  EXPECT_GT(largest_z(here, means_over_seeds(shape, shifted, 2000), same), 2 * kFamilyZ);
}

TEST(Equivariance, UnderRelabelling) {
  const Shape shape = testing::bent_prism();
  Shape relabelled = shape;
  std::vector<uint32_t> to(16);
  for (uint32_t v = 0; v < 16; ++v) to[v] = (5 * v + 3) % 16;
  for (uint32_t v = 0; v < 16; ++v)
    for (size_t k = 0; k < 3; ++k) relabelled.vertices[3 * to[v] + k] = shape.vertices[3 * v + k];
  for (uint32_t& corner : relabelled.quads) corner = to[corner];
  // Elements in reverse as well.
  std::reverse(relabelled.quads.begin(), relabelled.quads.end());
  const auto points = testing::random_points(20, 3, -0.5, 2.5, 29);
  EXPECT_LT(largest_z(means_over_seeds(shape, points, 1), means_over_seeds(relabelled, points, 1000), to), kFamilyZ);
}

// Outside, walks that come back by the exact law and walks that just go on have the same limit.
TEST(Outside, ReentryAgreesWithWalksThatGoOn) {
  const auto index = testing::make_index(testing::open_box());
  const std::vector<double> points = {0, 0, 1.6, 1.5, 0.3, 0.2, 2.5, 2.5, 0};
  Options options;
  options.samples = 40000;
  options.prune_below = 0.0;
  options.thickness = 1e-3;
  const RowBlock reentry = testing::bind_or_die(index, testing::loose_points(points), options);
  options.preset = Preset::kPaper;
  options.walk_steps_max = 2000;
  const RowBlock plain = testing::bind_or_die(index, testing::loose_points(points), options);
  for (size_t i = 0; i < 3; ++i) {
    const auto a = testing::dense_row(reentry, i, 8), b = testing::dense_row(plain, i, 8);
    for (size_t v = 0; v < 8; ++v) EXPECT_NEAR(a[v], b[v], 0.02) << "point " << i << " vertex " << v;
  }
}

// As the estimator that samples in one way measures it, inside a box.
double measured_noise(const Sampler<3>& sampler, const CageStructures<3>& structures, uint32_t samples) {
  const PointEstimator<3> estimator(structures.cage, *structures.walks, *structures.winding, sampler,
                                    {.thickness = 1e-3, .seed = 3, .pseudo_samples = PseudoSamples::kAlways});
  std::vector<Vec<3>> points;
  const auto at = testing::random_points(3200, 3, -0.25, 0.25, 5);
  for (size_t i = 0; i < 3200; ++i) points.emplace_back(at[3 * i], at[3 * i + 1], at[3 * i + 2]);
  const auto noise = relative_noise<3>(estimator, structures.cage, points, samples, kNeverCancelled);
  EXPECT_TRUE(noise.has_value());
  return noise.value_or(0.0);
}

TEST(Noise, IsThatOfTheMeanForIndependentSamplesAndLessForOthers) {
  const auto index = testing::make_index(testing::box());
  const auto& structures = *std::get<1>(index->structures());
  const auto walks = [&](uint32_t m, bool independent) {
    return measured_noise(HarmonicWalks<3>(*structures.walks, {.walks = m, .as_printed = independent}), structures, m);
  };
  const auto rays = [&](uint32_t m) {
    return measured_noise(RaySamples<3>(structures.cage, *structures.lines, {.rays = m}), structures, m);
  };
  // The paper's own discard leaves most of them.
  EXPECT_NEAR(std::sqrt(200.0) * walks(200, true), 1.0, 0.15);
  EXPECT_NEAR(walks(200, true) / walks(800, true), 2.0, 0.3);
  EXPECT_LT(walks(800, false), 0.75 * walks(800, true));
  EXPECT_LT(rays(200), 0.5 * walks(200, false));
  EXPECT_GT(rays(50) / rays(400), 5.0);
}

TEST(Noise, WithoutPointsToMeasureIsThatOfIndependentSamples) {
  const auto index = testing::make_index(testing::box());
  const auto& structures = *std::get<1>(index->structures());
  const HarmonicWalks<3> walks(*structures.walks, {.walks = 25});
  const PointEstimator<3> estimator(structures.cage, *structures.walks, *structures.winding, walks,
                                    {.thickness = 1e-3, .seed = 3, .pseudo_samples = PseudoSamples::kAlways});
  const std::vector<Vec<3>> on_the_cage{structures.cage.control_vertices()[0]};
  EXPECT_EQ(*relative_noise<3>(estimator, structures.cage, on_the_cage, 25, kNeverCancelled), 0.2);
  const std::atomic<bool> cancelled = true;
  EXPECT_FALSE(relative_noise<3>(estimator, structures.cage, on_the_cage, 25, cancelled).has_value());
}

}  // namespace
}  // namespace barycast
