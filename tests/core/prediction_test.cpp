// Harmonic coordinates by prediction and correction: where they converge to, however good the prediction is.

#include "solve/prediction.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include "estimate/corrected_estimator.h"
#include "estimate/missing_at_ends.h"
#include "query/element_distance.h"
#include "support/boundary_parts.h"
#include "support/seeds.h"

namespace barycast {
namespace {

using testing::OverSeeds;
using testing::Shape;
using testing::solved;

const CageStructures<3>& structures_of(const CageIndex& index) {
  return *std::get<std::unique_ptr<const CageStructures<3>>>(index.structures());
}

// An estimator with predictions of its own.
class Corrected {
 public:
  using Change = void (*)(DensityGroups&);

  // Applies `change` to what is solved for.
  Corrected(const CageIndex& index, uint32_t panels, uint32_t walks, double thickness, Change change)
      : structures_(structures_of(index)), walks_(walks), thickness_(thickness) {
    BoundaryParts inside = solved(structures_.cage, BoundarySides::kInside, panels),
                  elsewhere = solved(structures_.cage, BoundarySides::kElsewhere, panels);
    for (BoundaryParts* parts : {&inside, &elsewhere}) {
      change(parts->densities.inside);
      change(parts->densities.indirect);
    }
    inside_ = HarmonicPrediction::of(structures_.cage, *structures_.walks, std::move(inside));
    elsewhere_ = HarmonicPrediction::of(structures_.cage, *structures_.walks, std::move(elsewhere));
  }

  struct Rows {
    std::vector<Eigen::VectorXd> predicted, corrected;
    std::vector<Eigen::VectorXd> predicted_slopes, corrected_slopes;  // partial derivatives, per diagonal
  };
  // Of points in the cage's units; columns are those of the control vertices, all of which are used.
  Rows operator()(const std::vector<double>& points, uint64_t seed) const {
    const CorrectedEstimator estimator(
        structures_.cage, *structures_.walks, *structures_.winding,
        HarmonicWalks<3>(*structures_.walks, {.walks = walks_, .thickness = thickness_}), inside_.get(),
        elsewhere_.get(), nullptr,
        {.thickness = thickness_, .seed = seed, .gradients = true, .closed = structures_.is_closed()});
    std::vector<Vec<3>> normalized;
    for (size_t i = 0; i < points.size(); i += 3)
      normalized.push_back(structures_.cage.frame().to_normalized(Eigen::Map<const Vec<3>>(&points[i])));
    CorrectedEstimator::Workspace workspace;
    std::vector<CorrectedPoint> places(normalized.size());
    std::vector<float> corrections(normalized.size() * estimator.row_size());
    EXPECT_TRUE(estimator.correct(normalized, kNeverCancelled, workspace, places, corrections));
    Rows rows;
    const auto keep = [&](std::vector<Eigen::VectorXd>& values, std::vector<Eigen::VectorXd>& slopes) {
      values.resize(normalized.size());
      slopes.resize(normalized.size());
      return [&](size_t i, const CorrectedEstimator::Rows& row) {
        values[i] = row.values.transpose();
        slopes[i].resize(3 * row.values.size());
        slopes[i] << row.gradients[0].transpose(), row.gradients[1].transpose(), row.gradients[2].transpose();
      };
    };
    EXPECT_TRUE(estimator.evaluate(normalized, places, corrections, kNeverCancelled, workspace,
                                   keep(rows.corrected, rows.corrected_slopes)));
    std::fill(corrections.begin(), corrections.end(), 0.0f);
    EXPECT_TRUE(estimator.evaluate(normalized, places, corrections, kNeverCancelled, workspace,
                                   keep(rows.predicted, rows.predicted_slopes)));
    return rows;
  }

 private:
  const CageStructures<3>& structures_;
  uint32_t walks_;
  double thickness_;
  std::unique_ptr<const HarmonicPrediction> inside_, elsewhere_;
};

void right(DensityGroups&) {}
void too_small_on_half_of_the_cage(DensityGroups& groups) {
  for (auto& columns : groups) columns.topRows(columns.rows() / 2) *= 0.8;
}
// Those of other control vertices: of the box, of those across.
void of_others(DensityGroups& groups) {
  if (!groups.empty()) groups[0].leftCols<8>() = groups[0].leftCols<8>().rowwise().reverse().eval();
}

std::vector<Eigen::VectorXd> trilinear_rows(const std::vector<double>& points) {
  std::vector<Eigen::VectorXd> rows;
  for (size_t i = 0; i < points.size(); i += 3)
    rows.push_back(testing::trilinear(Eigen::Map<const Vec<3>>(&points[i])));
  return rows;
}

double root_mean_square(const std::vector<Eigen::VectorXd>& a, const std::vector<Eigen::VectorXd>& b) {
  return std::sqrt(testing::squared_difference(a, b) / double(a.size()));
}

TEST(Prediction, HasAFractionOfTheErrorOfAsManySamplesInABox) {
  const auto index = testing::make_index(testing::box());
  const auto points = testing::random_points(200, 3, -0.95, 0.95, 2);
  const auto error = [&](Estimator estimator) {
    const RowBlock block = testing::bind_or_die(index, testing::loose_points(points),
                                                {.estimator = estimator, .samples = 12, .prune_below = 0.0});
    std::vector<Eigen::VectorXd> rows;
    for (size_t i = 0; i < 200; ++i) rows.push_back(testing::row_vector(block, i, 8));
    return root_mean_square(rows, trilinear_rows(points));
  };
  const double predicted = error(Estimator::kPredicted);
  EXPECT_LT(predicted, 1e-3);
  EXPECT_LT(30 * predicted, error(Estimator::kSampling));
}

TEST(Prediction, LeavesLessToCorrectWithMorePanels) {
  const auto index = testing::make_index(testing::box());
  const auto points = testing::random_points(100, 3, -0.9, 0.9, 3);
  const auto correction = [&](uint32_t panels) {
    const Corrected::Rows rows = Corrected(*index, panels, 12, 1e-3, right)(points, 1);
    return root_mean_square(rows.predicted, rows.corrected);
  };
  const double coarse = correction(24), middle = correction(96), fine = correction(384);
  EXPECT_LT(middle, 0.5 * coarse);
  EXPECT_LT(fine, 0.5 * middle);
  EXPECT_LT(fine, 1e-3);
}

// Whatever the prediction: it is wrong here, and the mean of its corrections is right.
TEST(Prediction, ThatIsWrongIsCorrectedInABox) {
  const auto index = testing::make_index(testing::box());
  const auto points = testing::random_points(10, 3, -0.9, 0.9, 4);
  const auto exact = trilinear_rows(points);
  for (const Corrected::Change change : {too_small_on_half_of_the_cage, of_others}) {
    const Corrected estimator(*index, 120, 2000, 1e-4, change);
    std::vector<Corrected::Rows> rows;
    for (uint64_t seed = 0; seed < 8; ++seed) rows.push_back(estimator(points, seed));
    EXPECT_GT(root_mean_square(rows[0].predicted, exact), 0.01);
    const OverSeeds corrected =
        testing::over_seeds(10, 8, [&](uint64_t seed, size_t i) { return rows[seed].corrected[i]; });
    // The table of what is missing is bilinear between its nodes.
    EXPECT_LT(testing::squared_difference(corrected.mean, exact), 1.6 * corrected.noise + 10 * 1e-3 * 1e-3);
    EXPECT_LT(corrected.noise / 10, 2e-3 * 2e-3);
  }
}

// Its gradients, too: those of what it predicts well hardly change, of what it does not, nearly all of the error goes.
TEST(Prediction, ThatIsWrongHasItsGradientsCorrectedInABox) {
  const auto index = testing::make_index(testing::box());
  const auto points = testing::random_points(20, 3, -0.8, 0.8, 5);
  std::vector<Eigen::VectorXd> exact;
  const double diagonal = 2 * std::sqrt(3.0);
  for (size_t i = 0; i < points.size(); i += 3) {
    const Vec<3> x(points[i], points[i + 1], points[i + 2]);
    exact.emplace_back(24);
    for (int a = 0; a < 3; ++a)  // linear along every axis
      exact.back().segment<8>(8 * a) =
          diagonal * (testing::trilinear(x + 0.5 * Vec<3>::Unit(a)) - testing::trilinear(x - 0.5 * Vec<3>::Unit(a)));
  }
  for (const Corrected::Change change : {too_small_on_half_of_the_cage, of_others}) {
    const Corrected::Rows rows = Corrected(*index, 120, 4000, 1e-4, change)(points, 6);
    EXPECT_LT(root_mean_square(rows.corrected_slopes, exact), 0.15 * root_mean_square(rows.predicted_slopes, exact));
  }
  const Corrected::Rows rows = Corrected(*index, 480, 12, 1e-4, right)(points, 6);
  EXPECT_LT(root_mean_square(rows.corrected_slopes, exact), 1.1 * root_mean_square(rows.predicted_slopes, exact));
}

// Outside, and where the cage is open, moments are corrected: those of plain walks tell where to.
TEST(Prediction, ThatIsWrongIsCorrectedElsewhere) {
  for (const Shape& shape : {testing::box(), testing::open_box()}) {
    const auto index = testing::make_index(shape);
    const auto points = testing::random_points(10, 3, -1.6, 1.6, 5);
    const OverSeeds plain = testing::over_seeds(
        index, testing::loose_points(points),
        {.estimator = Estimator::kSampling, .samples = 3000, .thickness = 2e-4, .prune_below = 0.0}, 8);
    for (const Corrected::Change change : {too_small_on_half_of_the_cage, of_others}) {
      const Corrected estimator(*index, 120, 3000, 2e-4, change);
      std::vector<Corrected::Rows> rows;
      for (uint64_t seed = 0; seed < 8; ++seed) rows.push_back(estimator(points, 100 + seed));
      EXPECT_GT(root_mean_square(rows[0].predicted, plain.mean), 0.02);
      const OverSeeds corrected =
          testing::over_seeds(10, 8, [&](uint64_t seed, size_t i) { return rows[seed].corrected[i]; });
      EXPECT_LT(testing::squared_difference(corrected.mean, plain.mean),
                1.6 * (corrected.noise + plain.noise) + 10 * 3e-3 * 3e-3);
      EXPECT_LT(corrected.noise / 10, 0.02 * 0.02);
    }
  }
}

// Below a twisted patch a line crosses flat panels, where dipoles jump: the prediction is continued beyond them.
TEST(Prediction, InsideNothingJumpsBelowTwistedQuads) {
  const auto index = testing::make_index(testing::bent_prism());
  const CageStructures<3>& structures = structures_of(*index);
  const auto prediction =
      HarmonicPrediction::of(structures.cage, *structures.walks, solved(structures.cage, BoundarySides::kInside, 100));
  const double step = 1e-4;
  size_t steps = 0;
  for (uint32_t e = 0; e < structures.cage.elements().size(); ++e)
    for (const auto& at : {Vec<2>(0.2, 0.3), Vec<2>(0.5, 0.85), Vec<2>(0.76, 0.41)}) {
      const Element& element = structures.cage.elements()[e];
      const BilinearPatch patch = patch_of(structures.cage, element);
      const auto shares = patch.shares(at[0], at[1]);
      const Vec<3> inward = -structures.cage.orientation() * element_normal(structures.cage, element, shares);
      std::vector<Vec<3>> points;
      for (int i = 0; i < 200; ++i) points.push_back(patch.at(at[0], at[1]) + (1e-9 + i * step) * inward);
      if (!std::all_of(points.begin() + 1, points.end(), [&](const auto& x) { return structures.winding->inside(x); }))
        continue;
      HarmonicPrediction::Rows rows;
      EXPECT_TRUE(prediction->evaluate(points, false, kNeverCancelled, rows));
      for (Eigen::Index i = 1; i < rows.values.rows(); ++i, ++steps)
        EXPECT_LT((rows.values.row(i) - rows.values.row(i - 1)).norm(), 40 * step) << e << ", step " << i;
      // On the patch what is predicted and what it misses make the basis.
      std::vector<double> sum(static_cast<size_t>(prediction->columns()));
      prediction->add_missing(e, shares, 1.0, sum);
      BoundaryData::Row basis(prediction->columns());
      prediction->data().values(e, shares, points[0], basis);
      for (Eigen::Index v = 0; v < basis.size(); ++v)
        EXPECT_NEAR(double{rows.values(0, v)} + sum[static_cast<size_t>(v)], basis[v], 0.01) << e << ", column " << v;
    }
  EXPECT_GT(steps, 3000u);
}

// Inside, outside, closed, open, and what has no inside: as many walks with a prediction and without.
struct Case {
  const char* name;
  Shape shape;
};
void PrintTo(const Case& some, std::ostream* out) {
  *out << some.name;
}
Shape without_lids() {
  Shape shape = testing::bent_prism();
  shape.quads.resize(8 * 4);
  return shape;
}

class PredictedRowsOf : public ::testing::TestWithParam<Case> {};

TEST_P(PredictedRowsOf, ConvergeToWhereSamplesDo) {
  constexpr size_t kPoints = 10;
  const auto index = testing::make_index(GetParam().shape);
  const QueryInput queries = testing::loose_points(testing::random_points(kPoints, 3, -1.6, 1.6, 6));
  Options options{.estimator = Estimator::kSampling, .samples = 600, .thickness = 2e-4, .prune_below = 0.0};
  const OverSeeds plain = testing::over_seeds(index, queries, options, 6);
  options.estimator = Estimator::kPredicted;
  options.seed = 1000;
  const OverSeeds predicted = testing::over_seeds(index, queries, options, 6);
  // Of pseudo-samples, and of lines between the nodes of the table of what is missing.
  const double bias = 1e-3;
  EXPECT_LT(testing::squared_difference(plain.mean, predicted.mean),
            1.6 * (plain.noise + predicted.noise) + kPoints * bias * bias);
  EXPECT_LT(predicted.noise, plain.noise);
  EXPECT_LT(plain.noise / kPoints, 0.04 * 0.04);
}

INSTANTIATE_TEST_SUITE_P(
    Cages, PredictedRowsOf,
    ::testing::Values(Case{"bent_prism", testing::bent_prism()}, Case{"mixed_prism", testing::mixed_prism()},
                      Case{"open_box", testing::open_box()}, Case{"without_lids", without_lids()},
                      Case{"soup", testing::soup()},
                      Case{"holds_itself", testing::joined(testing::box(), testing::small_box(0.1, 0.2, 0.0))},
                      Case{"cuts_itself", testing::joined(testing::box(), testing::small_box(0.8, 0.7, 0.6))}),
    [](const auto& info) { return std::string(info.param.name); });

Shape two_boxes() {
  return testing::joined(testing::box(), testing::small_box(0.8, 0.7, 0.6));
}
// Next to where they cut each other: the face x = 1, and the small box's z = 0.1 and y = 0.2.
std::vector<double> next_to_the_cut() {
  std::vector<double> points;
  for (int i = 0; i < 8; ++i) {
    const double along = 0.3 + 0.08 * i, off = i % 2 == 0 ? 0.012 : -0.015;
    points.insert(points.end(), {1.0 - 0.02, along, 0.1 + off});
    points.insert(points.end(), {1.0 + 0.015, 0.2 - off, along});
  }
  return points;
}

// Against as many walks as leave next to no noise.
void expect_unbiased(const std::shared_ptr<const CageIndex>& index, const std::vector<double>& points) {
  const QueryInput queries = testing::loose_points(points);
  Options options{.estimator = Estimator::kSampling, .samples = 4000, .thickness = 1e-4, .prune_below = 0.0};
  const OverSeeds plain = testing::over_seeds(index, queries, options, 4);
  options.estimator = Estimator::kPredicted;
  options.samples = 400;
  options.seed = 1000;
  const OverSeeds predicted = testing::over_seeds(index, queries, options, 4);
  const double count = static_cast<double>(points.size() / 3), bias = 2e-3;
  EXPECT_LT(testing::squared_difference(plain.mean, predicted.mean),
            1.6 * (plain.noise + predicted.noise) + count * bias * bias);
  EXPECT_LT(plain.noise / count, 0.01 * 0.01);
  EXPECT_LT(predicted.noise / count, 0.01 * 0.01);
}

// What a prediction misses jumps and bends along the cut, where its table has no nodes.
TEST(PredictedRows, AreUnbiasedNextToACut) {
  expect_unbiased(testing::make_index(two_boxes()), next_to_the_cut());
}

// And bends over the width of a gap that is narrower than those are apart.
TEST(PredictedRows, AreUnbiasedInAGap) {
  const double gap = 0.05;
  const auto index = testing::make_index(testing::joined(testing::box(), testing::small_box(0.1, 0.2, 1.5 + gap)));
  std::vector<double> points = testing::random_points(16, 3, -0.4, 0.4, 15);
  for (size_t i = 2; i < points.size(); i += 3) points[i] = 1 + gap * (0.5 + points[i] / 3);
  expect_unbiased(index, points);
}

TEST(PredictedRows, NextToACutHaveTheSameBits) {
  const auto index = testing::make_index(two_boxes());
  const std::vector<double> points = next_to_the_cut();
  Options options{.estimator = Estimator::kPredicted, .gradients = true};
  const RowBlock rows = testing::bind_or_die(index, testing::loose_points(points), options);
  hwy::SetSupportedTargetsForTest(HWY_AVX2);
  const RowBlock narrow =
      testing::bind_or_die(testing::make_index(two_boxes()), testing::loose_points(points), options);
  hwy::SetSupportedTargetsForTest(0);
  EXPECT_EQ(rows.values, narrow.values);
  EXPECT_EQ(rows.gradients, narrow.gradients);
  for (size_t i = 0; i < rows.row_count(); ++i) {
    const RowBlock alone = testing::bind_or_die(
        index, testing::loose_points({points[3 * i], points[3 * i + 1], points[3 * i + 2]}), options);
    EXPECT_TRUE(std::ranges::equal(alone.values, std::span(rows.values).subspan(rows.offsets[i], alone.values.size())));
  }
}

// In a table's cells and on their elements' borders alike: there it is that of one side.
TEST(Prediction, MissesTheSameByTableAndEvaluated) {
  for (const Shape& shape : {testing::box(), testing::bent_prism()}) {
    const auto index = testing::make_index(shape);
    const auto& structures = structures_of(*index);
    const auto prediction =
        HarmonicPrediction::create(structures.cage, *structures.walks, BoundarySides::kInside).value();
    std::vector<ResidualTable::Node> places;
    for (uint32_t e = 0; e < structures.cage.elements().size(); ++e)
      for (const double u : {0.0, 1e-6, 0.3, 1.0})
        for (const double v : {0.0, 0.7, 1.0})
          places.push_back({e, {(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v}});
    HarmonicPrediction::Rows::Table missing;
    prediction->evaluate_missing(places, missing);
    for (size_t i = 0; i < places.size(); ++i) {
      std::vector<double> from_table(static_cast<size_t>(prediction->columns()), 0.0);
      prediction->add_missing(places[i].element, places[i].shares, 1.0, from_table);
      for (Eigen::Index c = 0; c < prediction->columns(); ++c)
        ASSERT_NEAR(double{missing(static_cast<Eigen::Index>(i), c)}, from_table[static_cast<size_t>(c)], 0.02)
            << i << ", column " << c;
    }
  }
}

TEST(Prediction, MissingAtEndsStopsWhenCancelled) {
  const auto index = testing::make_index(two_boxes());
  const auto& structures = structures_of(*index);
  const auto prediction =
      HarmonicPrediction::create(structures.cage, *structures.walks, BoundarySides::kInside).value();
  std::vector<Sample<3>> samples(1000);
  for (size_t k = 0; k < samples.size(); ++k)
    samples[k] = {Vec<3>::Zero(), 1.0, {0.25, 0.25, 0.25, 0.25}, static_cast<uint32_t>(k % 12), SampleEnd::kArrived};
  MissingAtEnds at_ends;
  std::atomic<bool> cancel = false;
  size_t found = 0;
  const auto count = [&](size_t k, std::span<const double> missing) {
    EXPECT_EQ(k, found++);
    EXPECT_EQ(missing.size(), static_cast<size_t>(prediction->columns()));
  };
  EXPECT_TRUE(at_ends.visit(*prediction, samples, cancel, count));
  EXPECT_EQ(found, samples.size());
  found = 0;
  EXPECT_FALSE(at_ends.visit(*prediction, samples, cancel, [&](size_t, std::span<const double>) {
    ++found;
    cancel = true;
  }));
  EXPECT_LT(found, 200u);
}

}  // namespace
}  // namespace barycast
