// The same point gets the same bytes: over threads, blocks, order, scale, and repetition.

#include <gtest/gtest.h>
#include <hwy/targets.h>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <bit>
#include <tuple>

#include "support/rows.h"

namespace barycast {
namespace {

bool same_bytes(const RowBlock& a, const RowBlock& b) {
  const auto equal = [](const std::vector<double>& x, const std::vector<double>& y) {
    return x.size() == y.size() && std::equal(x.begin(), x.end(), y.begin(), [](double p, double q) {
             return std::bit_cast<uint64_t>(p) == std::bit_cast<uint64_t>(q);
           });
  };
  return a.offsets == b.offsets && a.indices == b.indices && a.flags == b.flags && equal(a.values, b.values) &&
         equal(a.gradients, b.gradients);
}

Options gradients_too() {
  Options options;
  options.gradients = true;
  options.seed = 42;
  return options;
}

RowBlock in_arena(int threads, const std::shared_ptr<const CageIndex>& index, const QueryInput& queries,
                  const Options& options) {
  // More threads than cores, if need be: what is tested is the order of events.
  const tbb::global_control more(tbb::global_control::max_allowed_parallelism, 16);
  RowBlock rows;
  tbb::task_arena arena(threads);
  arena.execute([&] { rows = testing::bind_or_die(index, queries, options); });
  return rows;
}

class Determinism : public ::testing::TestWithParam<std::tuple<Preset, CoordinateKind, Estimator>> {
 protected:
  std::shared_ptr<const CageIndex> index_ = testing::make_index(testing::mixed_prism());
  std::vector<double> points_ = testing::random_points(300, 3, -1.5, 1.5, 1);
  Options options_ = [] {
    Options options = gradients_too();
    options.preset = std::get<Preset>(GetParam());
    options.coordinates = std::get<CoordinateKind>(GetParam());
    options.estimator = std::get<Estimator>(GetParam());
    return options;
  }();
};

// Bits are the same on every processor: what AVX-512 computes, narrower vectors compute too.
TEST_P(Determinism, OverVectorWidths) {
  if ((hwy::SupportedTargets() & HWY_AVX3) == 0) GTEST_SKIP() << "this processor has no AVX-512";
  const QueryInput loose = testing::loose_points(points_), mesh = testing::mesh_of(testing::sphere(12, 0.8));
  for (const QueryInput& queries : {loose, mesh}) {
    const RowBlock wide = testing::bind_or_die(index_, queries, options_);
    hwy::SetSupportedTargetsForTest(HWY_AVX2);
    // The cage's index as well: it is built with the same vectors.
    const RowBlock narrow = testing::bind_or_die(testing::make_index(testing::mixed_prism()), queries, options_);
    hwy::SetSupportedTargetsForTest(0);
    EXPECT_TRUE(same_bytes(wide, narrow));
  }
}

TEST_P(Determinism, OverThreads) {
  const QueryInput queries = testing::loose_points(points_);
  const RowBlock one = in_arena(1, index_, queries, options_);
  for (const int threads : {2, 7, 16})
    EXPECT_TRUE(same_bytes(one, in_arena(threads, index_, queries, options_))) << threads;
}

TEST_P(Determinism, OverOrderAndSubsets) {
  const RowBlock rows = testing::bind_or_die(index_, testing::loose_points(points_), options_);
  for (const size_t i : {0u, 17u, 299u}) {
    const RowBlock alone = testing::bind_or_die(
        index_, testing::loose_points({points_[3 * i], points_[3 * i + 1], points_[3 * i + 2]}), options_);
    const uint32_t begin = rows.offsets[i], end = rows.offsets[i + 1];
    EXPECT_TRUE(
        std::equal(alone.values.begin(), alone.values.end(), rows.values.begin() + begin, rows.values.begin() + end));
    EXPECT_TRUE(std::equal(alone.gradients.begin(), alone.gradients.end(), rows.gradients.begin() + 3 * begin,
                           rows.gradients.begin() + 3 * end));
  }
}

TEST_P(Determinism, OverBlocksAndResumption) {
  const auto resolved = resolve(options_, false);
  const RowBlock whole = testing::bind_or_die(index_, testing::loose_points(points_), options_);
  for (const uint32_t block_rows : {1u, 7u, 64u, 1000u})
    for (const uint64_t first_row : {uint64_t{0}, uint64_t{123}}) {
      auto binding = Binding::create(index_, testing::loose_points(points_),
                                     {.options = *resolved, .block_rows = block_rows, .first_row = first_row});
      ASSERT_TRUE(binding.ok());
      const std::atomic<bool> never = false;
      uint64_t next = first_row;
      for (Binding::Step step; (step = (*binding)->advance(never)) != Binding::Step::kDone;) {
        ASSERT_NE(step, Binding::Step::kCancelled);
        if (step != Binding::Step::kBlock) continue;
        const RowBlock block = (*binding)->take_block();
        ASSERT_EQ(block.first_row, next);
        ASSERT_LE(block.row_count(), block_rows);
        const uint32_t begin = whole.offsets[next], end = whole.offsets[next + block.row_count()];
        ASSERT_TRUE(std::equal(block.values.begin(), block.values.end(), whole.values.begin() + begin,
                               whole.values.begin() + end));
        next += block.row_count();
      }
      EXPECT_EQ(next, 300u);
    }
}

TEST_P(Determinism, UnderScalingByPowersOfTwo) {
  const RowBlock rows = testing::bind_or_die(index_, testing::loose_points(points_), options_);
  const auto scale = [](double factor) {
    return [factor](const Eigen::VectorXd& x) { return Eigen::VectorXd(x * factor); };
  };
  for (const double factor : {0.125, 1024.0}) {
    std::vector<double> scaled = points_;
    for (double& value : scaled) value *= factor;
    RowBlock other = testing::bind_or_die(testing::make_index(testing::mixed_prism().mapped(scale(factor))),
                                          testing::loose_points(scaled), options_);
    for (double& gradient : other.gradients) gradient *= factor;
    EXPECT_TRUE(same_bytes(rows, other));
  }
}

TEST_P(Determinism, OverFreshIndices) {
  const RowBlock rows = testing::bind_or_die(index_, testing::loose_points(points_), options_);
  EXPECT_TRUE(same_bytes(rows, testing::bind_or_die(testing::make_index(testing::mixed_prism()),
                                                    testing::loose_points(points_), options_)));
}

TEST_P(Determinism, OfSmoothedRows) {
  const QueryInput mesh = testing::mesh_of(testing::sphere(16, 0.8));
  const RowBlock rows = in_arena(1, index_, mesh, options_);
  EXPECT_TRUE(same_bytes(rows, in_arena(1, index_, mesh, options_)));
  for (const int threads : {2, 7}) EXPECT_TRUE(same_bytes(rows, in_arena(threads, index_, mesh, options_))) << threads;
}

TEST_P(Determinism, SeedsDiffer) {
  const RowBlock rows = testing::bind_or_die(index_, testing::loose_points(points_), options_);
  options_.seed = 43;
  EXPECT_FALSE(same_bytes(rows, testing::bind_or_die(index_, testing::loose_points(points_), options_)));
}

using Parameters = std::tuple<Preset, CoordinateKind, Estimator>;
std::string name_of(const ::testing::TestParamInfo<Parameters>& info) {
  const auto [preset, kind, estimator] = info.param;
  return std::string(estimator == Estimator::kPredicted ? "Predicted"
                     : preset == Preset::kPaper         ? "Paper"
                                                        : "Default") +
         (kind == CoordinateKind::kHarmonic    ? "Harmonic"
          : kind == CoordinateKind::kMeanValue ? "MeanValue"
                                               : "PositiveMeanValue");
}

// Whether points count as outside, too, where the cage does not enclose any: beside each other they may not share an
// answer.
TEST(DeterminismOfOpenCages, OverOrder) {
  const testing::Shape cup{.dimension = 2, .vertices = {-1, 1, -1, -1, 1, -1, 1, 1}, .segments = {0, 1, 1, 2, 2, 3}};
  for (const testing::Shape& shape : {cup, testing::open_box()})
    for (const CoordinateKind kind : {CoordinateKind::kHarmonic, CoordinateKind::kMeanValue}) {
      const auto index = testing::make_index(shape);
      const auto d = static_cast<size_t>(shape.dimension);
      const std::vector<double> points = testing::random_points(400, shape.dimension, -1.5, 1.5, 1);
      std::vector<double> reversed;
      for (size_t i = 400; i-- > 0;) reversed.insert(reversed.end(), &points[i * d], &points[i * d] + d);
      const Options options{.coordinates = kind, .samples = 20};
      const RowBlock rows = testing::bind_or_die(index, testing::loose_points(points), options),
                     back = testing::bind_or_die(index, testing::loose_points(reversed), options);
      for (size_t i = 0; i < 400; ++i) {
        EXPECT_EQ(rows.flags[i], back.flags[399 - i]);
        EXPECT_EQ(testing::dense_row(rows, i, index->control_vertex_count()),
                  testing::dense_row(back, 399 - i, index->control_vertex_count()));
      }
    }
}

INSTANTIATE_TEST_SUITE_P(PresetsAndKinds, Determinism,
                         ::testing::Combine(::testing::Values(Preset::kDefault, Preset::kPaper),
                                            ::testing::Values(CoordinateKind::kHarmonic, CoordinateKind::kMeanValue,
                                                              CoordinateKind::kPositiveMeanValue),
                                            ::testing::Values(Estimator::kSampling)),
                         name_of);
INSTANTIATE_TEST_SUITE_P(OfPredictions, Determinism,
                         ::testing::Values(Parameters{Preset::kDefault, CoordinateKind::kHarmonic,
                                                      Estimator::kPredicted}),
                         name_of);

}  // namespace
}  // namespace barycast
