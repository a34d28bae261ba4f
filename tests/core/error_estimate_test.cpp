#include "estimate/error_estimate.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "support/rows.h"

namespace barycast {
namespace {

// Vectors of `size` normal numbers, every one `decay` times the one before.
struct Coverage {
  double within, error, standard;
};
Coverage normal_coverage(size_t size, size_t count, double decay) {
  std::mt19937 generator(1);
  std::normal_distribution<double> normal;
  constexpr int kTrials = 4000;
  Coverage result{};
  Randomizations randomizations;
  std::vector<float> estimate(size), mean(size);
  for (int t = 0; t < kTrials; ++t) {
    randomizations.clear(size);
    for (size_t i = 0; i < count; ++i) {
      double scale = 1.0;
      for (float& value : estimate) {
        value = static_cast<float>(scale * normal(generator));
        scale *= decay;
      }
      randomizations.add(estimate);
    }
    randomizations.mean(mean);
    double squared = 0.0;
    for (const float value : mean) squared += double{value} * double{value};
    const Randomizations::Error error = randomizations.error();
    result.within += (std::sqrt(squared) <= error.at_95) / double{kTrials};
    result.error += squared / kTrials;
    result.standard += error.standard * error.standard / kTrials;
  }
  return result;
}

TEST(Randomizations, SayHowFarTheirMeanIsOff) {
  for (const size_t size : {1, 3, 48})
    for (const size_t count : {8, 32, 256})
      for (const double decay : {1.0, 0.9, 0.5}) {
        const Coverage found = normal_coverage(size, count, decay);
        EXPECT_NEAR(found.error / found.standard, 1.0, 0.1);
        EXPECT_GT(found.within, 0.93) << size << " numbers, " << count << " times, decay " << decay;
        EXPECT_LT(found.within, 0.975) << size << " numbers, " << count << " times, decay " << decay;
      }
}

TEST(Randomizations, OfNoNoiseAreExact) {
  Randomizations same(3);
  for (int i = 0; i < 3; ++i) same.add(std::vector<float>(3, 0.25f));
  EXPECT_EQ(same.error().standard, 0.0);
  EXPECT_EQ(same.error().at_95, 0.0);
}

double distance(const RowBlock& a, const RowBlock& b, size_t row, size_t columns) {
  const auto x = testing::dense_row(a, row, columns), y = testing::dense_row(b, row, columns);
  double squared = 0.0;
  for (size_t v = 0; v < columns; ++v) squared += (x[v] - y[v]) * (x[v] - y[v]);
  return std::sqrt(squared);
}

// Inside and outside, against many more walks: within three deviations of what 95 in 100 would give.
TEST(TargetError, CoversWhatRowsAreOffBy) {
  const testing::Shape shape = testing::bent_prism();
  const auto index = testing::make_index(shape);
  const QueryInput points = testing::loose_points(testing::random_points(400, 3, -0.5, 2.5, 7));
  Options options{.prune_below = 0.0, .target_error = 1.0};  // as few rounds as there can be
  const RowBlock rows = testing::bind_or_die(index, points, options);
  options = {.samples = 2000, .seed = 1, .prune_below = 0.0};
  const RowBlock exact = testing::bind_or_die(index, points, options);
  ASSERT_EQ(rows.errors.size(), 2 * rows.row_count());
  size_t within = 0, counted = 0;
  for (size_t i = 0; i < rows.row_count(); ++i) {
    if ((rows.flags[i] & kRowOnCage) != 0) continue;
    ++counted;
    // The final correction of rows is a projection: what is left of their noise is less.
    const double error = distance(rows, exact, i, index->control_vertex_count());
    within += error <= double{rows.errors[2 * i + 1]};
  }
  const auto rows_counted = static_cast<double>(counted);
  EXPECT_NEAR(static_cast<double>(within), 0.95 * rows_counted, 3 * std::sqrt(0.95 * 0.05 * rows_counted));
}

TEST(TargetError, IsMetRowByRow) {
  const auto index = testing::make_index(testing::bent_prism());
  const auto coordinates = testing::random_points(60, 3, -0.2, 2.2, 3);
  constexpr double kTarget = 5e-3;
  const Options options{.target_error = kTarget};
  BindingSummary summary;
  const RowBlock rows = testing::bind_or_die(index, testing::loose_points(coordinates), options, &summary);
  EXPECT_EQ(summary.rows_above_target, 0u);
  for (size_t i = 0; i < rows.row_count(); ++i) EXPECT_LE(rows.errors[2 * i], kTarget);
  EXPECT_GT(summary.samples, 60u * 8 * 12);
  // A row does not depend on the points beside it.
  for (const size_t i : {size_t{0}, size_t{17}}) {
    const RowBlock alone = testing::bind_or_die(
        index, testing::loose_points({coordinates[3 * i], coordinates[3 * i + 1], coordinates[3 * i + 2]}), options);
    EXPECT_EQ(testing::dense_row(alone, 0, 16), testing::dense_row(rows, i, 16));
    EXPECT_EQ(alone.errors[0], rows.errors[2 * i]);
  }
}

// There values are the basis', whatever walks from beside it find.
TEST(TargetError, IsMetOnTheCage) {
  const auto index = testing::make_index(testing::box());
  BindingSummary summary;
  const Options options{.target_error = 1e-5};
  const RowBlock rows =
      testing::bind_or_die(index, testing::loose_points({1, 0.3, -0.2, 0.1, -1, 0.9}), options, &summary);
  for (const float error : rows.errors) EXPECT_EQ(error, 0.0f);
  EXPECT_EQ(summary.rows_above_target, 0u);
  EXPECT_EQ(summary.samples, 2u * 8 * 12);
}

TEST(TargetError, IsRefusedWhereItMakesNoSense) {
  const auto field = [](const Options& options) { return resolve(options, true).error().field; };
  EXPECT_EQ(field({.coordinates = CoordinateKind::kMeanValue, .target_error = 1e-3}), "target_error");
  EXPECT_EQ(field({.estimator = Estimator::kSampling, .target_error = 1e-3}), "target_error");
  EXPECT_EQ(field({.samples = 12, .target_error = 1e-3}), "samples");
  EXPECT_EQ(field({.target_error = 1e-3, .tables = true}), "tables");
  EXPECT_EQ(field({.denoise = Denoise::kMesh, .target_error = 1e-3}), "denoise");
  for (const double target : {0.0, -1.0, 9e-6, 1.1, std::nan("")})
    EXPECT_EQ(field({.target_error = target}), "target_error");
  const testing::Shape large = testing::sphere(12, 1.0);
  EXPECT_EQ(bind_all(*CageIndex::create(large.input()), testing::loose_points({0, 0, 0}),
                     *resolve({.target_error = 1e-3}, false))
                .error()
                .field,
            "estimator");
}

}  // namespace
}  // namespace barycast
