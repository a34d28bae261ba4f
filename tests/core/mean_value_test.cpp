// Mean value and positive mean value coordinates: against closed forms, against each other, and how fast
// they converge.

#include <gtest/gtest.h>

#include "query/distance_index.h"
#include "query/winding.h"
#include "sample/rays.h"
#include "support/mean_value.h"
#include "support/rows.h"

namespace barycast {
namespace {

using testing::Shape;

Options with(CoordinateKind kind, Preset preset, uint32_t samples) {
  Options options;
  options.coordinates = kind;
  options.preset = preset;
  options.samples = samples;
  options.prune_below = 0.0;
  return options;
}

// E over points against a closed form.
template <int D, class Reference>
double error_of(const Shape& shape, const std::vector<double>& points, const Options& options,
                const Reference& reference) {
  const auto index = testing::make_index(shape);
  const RowBlock rows = testing::bind_or_die(index, testing::loose_points(points), options);
  double squared = 0.0;
  for (size_t i = 0; i < rows.row_count(); ++i) {
    const auto row = testing::dense_row(rows, i, shape.vertex_count());
    const auto expected = reference(shape, Eigen::Map<const Vec<D>>(points.data() + D * i));
    for (size_t v = 0; v < row.size(); ++v) squared += std::pow(row[v] - expected[v], 2);
  }
  return std::sqrt(squared / static_cast<double>(rows.row_count()));
}

double mesh_error(const Shape& shape, const std::vector<double>& points, const Options& options) {
  return error_of<3>(shape, points, options, testing::mesh_mean_value);
}

// Inside, outside near and far; none within a hundredth of the cage.
std::vector<double> points_off(const Shape& shape, double reach, uint32_t seed) {
  const auto index = testing::make_index(shape);
  const auto& structures = *std::get<std::unique_ptr<const CageStructures<3>>>(index->structures());
  std::vector<double> result;
  const auto candidates = testing::random_points(300, 3, -reach, reach, seed);
  for (size_t i = 0; i < candidates.size() && result.size() < 3 * 60; i += 3) {
    const Vec<3> x = structures.cage.frame().to_normalized(Eigen::Map<const Vec<3>>(candidates.data() + i));
    if ((*structures.walks).closest(x).distance > 0.01) result.insert(result.end(), &candidates[i], &candidates[i] + 3);
  }
  return result;
}

TEST(MeanValue, IsTheClosedFormOnTriangleCages) {
  for (const Shape& shape : {testing::triangulated(testing::box()), testing::triangulated(testing::bent_prism()),
                             testing::triangulated(testing::sphere(6, 1.0))})
    for (const double reach : {1.0, 2.5, 10.0, 300.0}) {
      const auto points = points_off(shape, reach, 11);
      ASSERT_GE(points.size(), 3u * 20);
      // Far away hits of either sign nearly cancel, and the error grows with the distance.
      EXPECT_LT(mesh_error(shape, points, with(CoordinateKind::kMeanValue, Preset::kDefault, 20000)),
                2e-3 * std::max(1.0, reach / 10))
          << reach;
      // Half the digits: independent rays, and no more than 20000 samples.
      if (reach == 1.0) {
        EXPECT_LT(mesh_error(shape, points, with(CoordinateKind::kMeanValue, Preset::kPaper, 20000)), 6e-2);
      }
    }
}

TEST(MeanValue, IsTheClosedFormOnPolygons) {
  const Shape shape = testing::star_polygon();
  for (const double reach : {0.3, 2.0, 20.0}) {
    const auto points = testing::random_points(40, 2, -reach, reach, 3);
    EXPECT_LT(error_of<2>(shape, points, with(CoordinateKind::kMeanValue, Preset::kDefault, 20000),
                          testing::polygon_mean_value),
              5e-3)
        << reach;
  }
}

double mean_value_slope(Preset preset) {
  const Shape shape = testing::triangulated(testing::bent_prism());
  std::vector<double> points;
  const auto index = testing::make_index(shape);
  const auto& structures = *std::get<std::unique_ptr<const CageStructures<3>>>(index->structures());
  const auto candidates = points_off(shape, 2.0, 5);
  for (size_t i = 0; i < candidates.size(); i += 3)
    if (structures.winding->inside(
            structures.cage.frame().to_normalized(Eigen::Map<const Vec<3>>(candidates.data() + i))))
      points.insert(points.end(), &candidates[i], &candidates[i] + 3);
  double sxy = 0.0, sxx = 0.0;
  for (int k = -2; k <= 2; ++k) {  // m = 32 ... 512, about 128
    double squared = 0.0;
    constexpr int kSeeds = 20;
    for (uint64_t seed = 0; seed < kSeeds; ++seed) {
      Options options = with(CoordinateKind::kMeanValue, preset, static_cast<uint32_t>(128 * std::pow(2.0, k)));
      options.seed = seed;
      squared += std::pow(mesh_error(shape, points, options), 2) / kSeeds;
    }
    sxy += k * 0.5 * std::log2(squared);
    sxx += k * k;
  }
  return sxy / sxx;
}

TEST(MeanValue, ErrorFallsWithTheNumberOfRays) {
  EXPECT_LE(mean_value_slope(Preset::kDefault), -0.9);
  // Independent directions are what the test can tell from a lattice.
  EXPECT_NEAR(mean_value_slope(Preset::kPaper), -0.5, 0.15);
}

// Meets nothing, and remembers the directions of lines.
class Recorder final : public LineIndex<3> {
 public:
  void hits(const Vec<3>&, std::span<const Vec<3>> directions, double, LineHits<3>& out) const override {
    out = {};
    out.end.assign(directions.size(), 0);
    for (const Vec<3>& direction : directions) second += direction * direction.transpose();
    count += directions.size();
  }
  size_t bytes() const override { return 0; }
  mutable Mat<3> second = Mat<3>::Zero();
  mutable size_t count = 0;
};

// The lattice is rotated uniformly, so that the mean over queries prefers no axis, however few its lines: the
// second moment of a uniform direction is I / 3. Noise of the mean: 0.005.
TEST(Rays, PreferNoDirection) {
  const auto index = testing::make_index(testing::box());
  const auto& structures = *std::get<std::unique_ptr<const CageStructures<3>>>(index->structures());
  const std::atomic<bool> never = false;
  std::vector<SampleSet<3>> samples(1);
  for (const uint32_t rays : {2u, 10u}) {
    const Recorder recorder;
    const RaySamples<3> sampler(structures.cage, recorder, {.rays = rays});
    for (uint64_t key = 0; key < 40000; ++key) {
      const std::vector<SampleQuery<3>> query{{Vec<3>::Zero(), 0.1, QueryRandom(1, key)}};
      ASSERT_TRUE(sampler.sample(query, never, samples));
    }
    ASSERT_EQ(recorder.count, 40000 * rays / 2);
    EXPECT_LT((recorder.second / static_cast<double>(recorder.count) - Mat<3>::Identity() / 3).norm(),
              rays == 2 ? 0.015 : 0.003);
  }
}

// From anywhere, a line meets a convex cage at most twice, so that everything is visible.
TEST(PositiveMeanValue, IsMeanValueInConvexCages) {
  for (const Shape& shape : {testing::box(), testing::triangulated(testing::sphere(6, 1.0)), testing::tetrahedron()})
    for (const Preset preset : {Preset::kDefault, Preset::kPaper}) {
      const auto index = testing::make_index(shape);
      const auto points = testing::random_points(100, 3, -1.5, 1.5, 8);
      const RowBlock plain =
          testing::bind_or_die(index, testing::loose_points(points), with(CoordinateKind::kMeanValue, preset, 50));
      const RowBlock positive = testing::bind_or_die(index, testing::loose_points(points),
                                                     with(CoordinateKind::kPositiveMeanValue, preset, 50));
      EXPECT_EQ(plain.indices, positive.indices);
      EXPECT_EQ(plain.values, positive.values);
    }
}

// In the notch of an L the far arm is hidden: positive mean value coordinates know nothing of it, and are
// positive, where mean value coordinates are not.
TEST(PositiveMeanValue, SeesOnlyWhatIsVisible) {
  const Shape shape = testing::triangulated(testing::bent_prism());
  const auto index = testing::make_index(shape);
  const std::vector<double> points = {1.9, 0.85, 0.5};
  double least[2];
  for (const CoordinateKind kind : {CoordinateKind::kMeanValue, CoordinateKind::kPositiveMeanValue}) {
    const RowBlock rows =
        testing::bind_or_die(index, testing::loose_points(points), with(kind, Preset::kDefault, 20000));
    least[kind == CoordinateKind::kPositiveMeanValue] = *std::min_element(rows.values.begin(), rows.values.end());
  }
  EXPECT_LT(least[0], -1e-3);
  EXPECT_GT(least[1], -2e-4);
}

}  // namespace
}  // namespace barycast
