// The reference instruments of tests/support: each against a closed form, and against the library's samplers, with
// which they share nothing but the cage.

#include <gtest/gtest.h>

#include "support/boundary_elements_2d.h"
#include "support/mean_value.h"
#include "support/positive_mean_value.h"
#include "support/rows.h"
#include "support/volumetric_harmonic.h"

namespace barycast {
namespace {

using testing::DenseRows;
using testing::Shape;

template <int D>
Cage<D> cage_of(const Shape& shape) {
  return Cage<D>::create(shape.input()).value();
}

// Rows by a closed form of (shape, point in the caller's frame).
template <int D, class Form>
DenseRows closed_form(const Shape& shape, const std::vector<double>& points, const Form& form) {
  DenseRows rows(static_cast<Eigen::Index>(points.size() / D), static_cast<Eigen::Index>(shape.vertex_count()));
  for (Eigen::Index i = 0; i < rows.rows(); ++i) {
    const std::vector<double> row = form(shape, Vec<D>(Eigen::Map<const Vec<D>>(points.data() + D * i)));
    rows.row(i) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), rows.cols());
  }
  return rows;
}

// Multilinear in [-1, 1]^D, corners anywhere.
template <int D>
std::vector<double> multilinear(const Shape& shape, const Vec<D>& x) {
  std::vector<double> row;
  for (uint32_t v = 0; v < shape.vertex_count(); ++v)
    row.push_back(((Vec<D>::Ones() + testing::vertex_of<D>(shape, v).cwiseProduct(x)) / 2).prod());
  return row;
}

DenseRows sampled(const Shape& shape, const std::vector<double>& points, CoordinateKind kind, uint32_t samples,
                  uint64_t seed = 0) {
  const auto index = testing::make_index(shape);
  Options options;
  options.coordinates = kind;
  options.samples = samples;
  options.seed = seed;
  options.prune_below = 0.0;
  options.thickness = 1e-5;
  const RowBlock block = testing::bind_or_die(index, testing::loose_points(points), options);
  DenseRows rows(static_cast<Eigen::Index>(block.row_count()), static_cast<Eigen::Index>(shape.vertex_count()));
  for (Eigen::Index i = 0; i < rows.rows(); ++i) {
    const auto row = testing::dense_row(block, static_cast<size_t>(i), shape.vertex_count());
    rows.row(i) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), rows.cols());
  }
  return rows;
}

// In a convex cage everything is visible. Kinks at edges leave an error of about 1 / directions.
TEST(PositiveMeanValueReference, IsTheClosedFormInConvexCages) {
  for (const Shape& shape : {testing::triangulated(testing::box()), testing::triangulated(testing::sphere(6, 1.0))}) {
    const auto points = testing::random_points(30, 3, -0.55, 0.55, 3);
    const DenseRows expected = closed_form<3>(shape, points, testing::mesh_mean_value);
    const auto error = [&](size_t directions) {
      return testing::row_error(testing::positive_mean_value(cage_of<3>(shape), points, directions), expected);
    };
    EXPECT_LT(error(1000), 2e-3);   // measured 1e-4 and 6e-4
    EXPECT_LT(error(10000), 1e-4);  // 6e-6 and 4e-5
  }
}

// Outside hits of either sign nearly cancel; a cone of directions and the parity of hits are tested too.
TEST(PositiveMeanValueReference, IsTheClosedFormOutsideConvexCages) {
  const Shape shape = testing::triangulated(testing::box());
  for (const double reach : {2.5, 10.0}) {
    const auto points = testing::random_points(30, 3, -reach, reach, 3);
    EXPECT_LT(testing::row_error(testing::positive_mean_value(cage_of<3>(shape), points, 10000),
                                 closed_form<3>(shape, points, testing::mesh_mean_value)),
              1e-4 * reach);  // measured 5e-5 and 3e-4
  }
}

TEST(PositiveMeanValueReference, IsWhatTheLibrarySamples) {
  for (const Shape& shape : {testing::bent_prism(), testing::mixed_prism()}) {
    const auto points = testing::random_points(30, 3, -0.5, 2.2, 7);
    EXPECT_LT(testing::row_error(sampled(shape, points, CoordinateKind::kPositiveMeanValue, 10000),
                                 testing::positive_mean_value(cage_of<3>(shape), points, 20000)),
              1e-3);  // measured 7e-4, 5e-4
  }
  // In one arm of the L, where most of the other is hidden.
  const Shape shape = testing::bent_prism();
  std::vector<double> points = testing::random_points(30, 3, 0.1, 0.9, 7);
  for (size_t i = 0; i < points.size(); i += 3) points[i] += 1;
  const DenseRows reference = testing::positive_mean_value(cage_of<3>(shape), points, 20000);
  EXPECT_LT(testing::row_error(sampled(shape, points, CoordinateKind::kPositiveMeanValue, 10000), reference),
            5e-4);                                                                                            // 1.2e-4
  EXPECT_GT(testing::row_error(sampled(shape, points, CoordinateKind::kMeanValue, 10000), reference), 5e-3);  // 1.1e-2
}

TEST(VolumetricReference, ConvergesToTrilinearInABox) {
  const Shape shape = testing::box();
  const auto points = testing::random_points(200, 3, -0.95, 0.95, 1);
  const DenseRows expected = closed_form<3>(shape, points, multilinear<3>);
  // Turned against the grid.
  const Mat<3> rotation = Eigen::AngleAxisd(0.7, Vec<3>(1, 2, 3).normalized()).toRotationMatrix();
  const Shape turned = shape.mapped([&](const Eigen::VectorXd& x) { return Eigen::VectorXd(rotation * x); });
  std::vector<double> turned_points = points;
  Eigen::Map<Eigen::Matrix3Xd>(turned_points.data(), 3, 200).applyOnTheLeft(rotation);
  double last = 0.08;
  for (const int resolution : {12, 24, 48}) {  // measured 0.037, 0.020, 0.0096
    const Cage<3> cage = cage_of<3>(turned);
    const DenseRows rows = testing::VolumetricHarmonic(cage, resolution).evaluate(turned_points);
    ASSERT_TRUE(rows.allFinite());
    EXPECT_LT((rows.rowwise().sum().array() - 1).abs().maxCoeff(), 1e-6);
    const double error = testing::row_error(rows, expected);
    EXPECT_LT(error, 0.6 * last);
    last = error;
  }
  const Cage<3> cage = cage_of<3>(shape);
  EXPECT_LT(testing::row_error(testing::VolumetricHarmonic(cage, 32).evaluate(points), expected), 0.006);  // 0.0047
}

TEST(VolumetricReference, KnowsNothingOutside) {
  const Cage<3> cage = cage_of<3>(testing::bent_prism()), open = cage_of<3>(testing::open_box());
  const std::vector<double> points = {0.5, 0.5, 0.5, 1.5, 0.4, 0.6, 1.7, 1.7, 0.5, 1e9, -1e12, 0};
  const DenseRows rows = testing::VolumetricHarmonic(cage, 24).evaluate(points);
  for (Eigen::Index i = 0; i < 4; ++i) EXPECT_EQ(rows.row(i).allFinite(), i < 2) << i;
  EXPECT_TRUE(testing::VolumetricHarmonic(open, 24).evaluate(std::vector<double>{0, 0, 0}).array().isNaN().all());
}

// Third order: the square is convex, so that only the outer density is singular.
TEST(BoundaryElementsReference, AreBilinearInASquare) {
  const Shape shape = testing::square();
  const auto points = testing::random_points(200, 2, -0.95, 0.95, 1);
  const DenseRows expected = closed_form<2>(shape, points, multilinear<2>);
  const Cage<2> cage = cage_of<2>(shape);
  const auto error = [&](int panels) {
    return testing::row_error(testing::BoundaryElements2d(cage, panels).evaluate(points), expected);
  };
  EXPECT_LT(error(16), 5e-4);  // measured 2.7e-4
  EXPECT_LT(error(64), 1e-5);  // 3.4e-6
}

// Walks know nothing of panels; both know that outside the moments are projected. The noise is what runs differ by;
// their mean is no further from the reference than it allows (ten points: give or take a few tenths).
TEST(BoundaryElementsReference, AreWhatWalksConvergeTo) {
  constexpr int kRuns = 8;
  const Shape star = testing::star_polygon();
  Shape open = star;
  open.segments.resize(size_t{2} * 7);
  for (const Shape& shape : {star, open})
    for (const double reach : {0.5, 2.0, 10.0}) {
      const auto points = testing::random_points(10, 2, -reach, reach, 11);
      const Cage<2> cage = cage_of<2>(shape);
      const DenseRows reference = testing::BoundaryElements2d(cage, 64).evaluate(points);
      // Measured 4e-5 to 3e-4; third order, so that an eighth of it is left at 64 panels.
      EXPECT_LT(testing::row_error(testing::BoundaryElements2d(cage, 32).evaluate(points), reference), 1e-3) << reach;
      std::vector<DenseRows> runs;
      DenseRows mean = DenseRows::Zero(reference.rows(), reference.cols());
      for (int run = 0; run < kRuns; ++run) {
        runs.push_back(sampled(shape, points, CoordinateKind::kHarmonic, 2000, static_cast<uint64_t>(run) + 1));
        mean += runs.back() / kRuns;
      }
      double variance = 0.0;
      for (const DenseRows& run : runs) variance += std::pow(testing::row_error(run, mean), 2) / (kRuns - 1);
      const double noise = std::sqrt(variance / kRuns);
      EXPECT_LT(testing::row_error(mean, reference), 1.4 * noise) << reach;
      EXPECT_LT(noise, 0.01 * std::max(1.0, 2 * reach)) << reach;
    }
}

// Linear functions: exactly, for the projection reproduces them whatever the density.
TEST(BoundaryElementsReference, ReproduceLinearFunctions) {
  const Shape shape = testing::star_polygon();
  const auto points = testing::random_points(50, 2, -3, 3, 5);
  const DenseRows rows = testing::BoundaryElements2d(cage_of<2>(shape), 16).evaluate(points);
  const DenseRows vertices = Eigen::Map<const DenseRows>(shape.vertices.data(), 10, 2);
  EXPECT_LT((rows * vertices - Eigen::Map<const DenseRows>(points.data(), 50, 2)).cwiseAbs().maxCoeff(), 1e-10);
}

}  // namespace
}  // namespace barycast
