// Corrections from tables of balls: the cover, the expansion, and that nothing but the cage can change a table.

#include "estimate/ball_tables.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <thread>

#include "support/rows.h"

namespace barycast {
namespace {

Options with_tables() {
  Options options;
  options.estimator = Estimator::kPredicted;
  options.tables = true;
  return options;
}

// A cage with what its tables need.
struct Prepared {
  explicit Prepared(const testing::Shape& shape) : index(testing::make_index(shape)) {
    EXPECT_TRUE(index->prepare(*resolve(with_tables(), false)).ok());
  }
  const CageStructures<3>& structures() const {
    return *std::get<std::unique_ptr<const CageStructures<3>>>(index->structures());
  }
  const BallTables& tables() const { return *structures().tables; }
  BallTables fresh(const BallTableSettings& settings) const {
    return {structures().cage, *structures().walks, *structures().winding, *structures().inside, settings};
  }
  // Points of the inside, normalized, that are further from the cage than the cover's least distance.
  std::vector<Vec<3>> points(size_t count, uint32_t seed) const {
    std::vector<Vec<3>> result;
    for (uint32_t round = 0; result.size() < count; ++round) {
      const std::vector<double> x = testing::random_points(4 * count, 3, -0.5, 0.5, seed + 1000 * round);
      for (size_t i = 0; i < x.size() && result.size() < count; i += 3) {
        const Vec<3> p(x[i], x[i + 1], x[i + 2]);
        if (!structures().winding->inside(p)) continue;
        if (structures().walks.get()->closest(p).distance > BallCover::kDistanceMin) result.push_back(p);
      }
    }
    return result;
  }

  std::shared_ptr<const CageIndex> index;
};

using Row = std::vector<float>;

Row correct(const BallTables& tables, std::span<const Vec<3>> points) {
  const std::atomic<bool> never = false;
  BallTables::Workspace workspace;
  Row rows(points.size() * tables.columns());
  EXPECT_TRUE(tables.correct(points, false, never, workspace, rows));
  return rows;
}

std::vector<testing::Shape> cages() {
  return {testing::box(), testing::bent_prism(), testing::mixed_prism(), testing::flat_tetrahedron(),
          testing::sphere(6, 2.0)};
}

TEST(BallTables, HarmonicPolynomialsAreFoundExactly) {
  // Some dozen directions that lie unevenly.
  std::vector<Vec<3>> directions;
  for (size_t i = 0; i < 50; ++i) {
    const std::vector<double> x = testing::random_points(1, 3, -1, 1, static_cast<uint32_t>(i));
    directions.push_back((Vec<3>(x[0], x[1], x[2] + 0.3)).normalized());
  }
  const auto polynomial = [](const Vec<3>& x) {
    return 0.7 - x[0] + 2 * x[1] + 0.3 * x[2] + x[0] * x[1] - 3 * x[1] * x[2] + 0.5 * x[0] * x[2] +
           1.5 * (x[0] * x[0] - x[2] * x[2]) - (x[1] * x[1] - x[2] * x[2]);
  };
  const std::vector<HarmonicValues> factors = harmonic_projection(directions);
  std::array<double, kHarmonics> coefficients{};
  for (size_t i = 0; i < directions.size(); ++i)
    for (size_t j = 0; j < kHarmonics; ++j) coefficients[j] += factors[i][j] * polynomial(directions[i]);
  for (const Vec<3>& x : {Vec<3>(0, 0, 0), Vec<3>(0.3, -0.5, 0.2), Vec<3>(-0.1, 0.2, 0.6)}) {
    double value = 0.0;
    const HarmonicValues b = solid_harmonics(x);
    for (size_t j = 0; j < kHarmonics; ++j) value += double{b[j]} * coefficients[j];
    EXPECT_NEAR(value, polynomial(x), 1e-5);
    const std::array<HarmonicValues, 3> partials = solid_harmonic_gradients(x);
    for (int a = 0; a < 3; ++a) {
      double slope = 0.0;
      for (size_t j = 0; j < kHarmonics; ++j) slope += double{partials[static_cast<size_t>(a)][j]} * coefficients[j];
      const Vec<3> step = 0.01 * Vec<3>::Unit(a);
      EXPECT_NEAR(slope, (polynomial(x + step) - polynomial(x - step)) / 0.02, 1e-4);
    }
  }
}

TEST(BallTables, HarmonicsAreOrthonormalOverTheSphere) {
  std::vector<Vec<3>> directions;
  for (uint32_t i = 0; i < 2000; ++i) {
    const double z = 1 - (2 * i + 1) / 2000.0, r = std::sqrt(1 - z * z), angle = 2.399963229728653 * i;
    directions.emplace_back(r * std::cos(angle), r * std::sin(angle), z);
  }
  for (size_t j = 0; j < kHarmonics; ++j)
    for (size_t k = 0; k < kHarmonics; ++k) {
      double mean = 0.0;
      for (const Vec<3>& s : directions) {
        const HarmonicValues b = solid_harmonics(s);
        mean += double{b[j]} * double{b[k]} / static_cast<double>(directions.size());
      }
      EXPECT_NEAR(mean, j == k ? 1.0 : 0.0, 2e-3) << j << ' ' << k;
    }
}

TEST(BallTables, BallsCoverWhatIsNotNearTheCage) {
  for (const testing::Shape& shape : cages()) {
    const Prepared cage(shape);
    const BallCover cover(*cage.structures().walks, *cage.structures().winding);
    for (const Vec<3>& x : cage.points(500, 1)) {
      EXPECT_GT(cover.clearance(x), 0);
      EXPECT_LE(cover.clearance(x), cage.structures().walks.get()->closest(x).distance);
      double sum = 0.0;
      cover.for_each(x, [&](const BallLeaf& leaf, double weight) {
        sum += weight;
        EXPECT_LT((x - leaf.centre).norm(), 0.81 * leaf.radius);
        EXPECT_LT(leaf.radius, cage.structures().walks.get()->closest(leaf.centre).distance);
      });
      // In a cell at least: a half along every axis, at its corner.
      ASSERT_GE(sum, 0.999 / 8) << x.transpose();
    }
    for (const Vec<3>& x : {Vec<3>(0.7, 0, 0), Vec<3>(0, -5, 0), Vec<3>(0.3, 0.4, -1e9)})
      EXPECT_EQ(cover.clearance(x), 0);
    EXPECT_GT(cover.bytes(), sizeof(BallCover));
  }
}

TEST(BallTables, AllLeavesAreThoseThatPointsFind) {
  const Prepared cage(testing::flat_tetrahedron());
  const BallCover cover(*cage.structures().walks, *cage.structures().winding);
  std::atomic<bool> cancel = false;
  const std::vector<const BallLeaf*> leaves = cover.leaves(1'000'000, cancel);
  EXPECT_EQ(cover.leaves(100, cancel), std::vector(leaves.begin(), leaves.begin() + 100));
  for (const Vec<3>& x : cage.points(200, 2))
    cover.for_each(x, [&](const BallLeaf& leaf, double) {
      EXPECT_NE(std::find(leaves.begin(), leaves.end(), &leaf), leaves.end());
    });
  cancel = true;
  EXPECT_TRUE(BallCover(*cage.structures().walks, *cage.structures().winding).leaves(1'000'000, cancel).empty());
}

TEST(BallTables, CorrectionsAreContinuous) {
  for (const testing::Shape& shape : {testing::bent_prism(), testing::sphere(6, 2.0)}) {
    const Prepared cage(shape);
    const std::vector<Vec<3>> ends = cage.points(40, 3);
    constexpr double kStep = 1e-5;
    for (const Vec<3>& x : ends) {
      // Steps of a segment, as long as it stays away from the cage.
      std::vector<Vec<3>> path;
      const Vec<3> direction = Vec<3>(x[1] + 0.1, x[2] - 0.2, x[0] + 0.3).normalized();
      for (int i = 0; i < 2000; ++i) {
        path.push_back(x + i * kStep * direction);
        if (cage.structures().walks.get()->closest(path.back()).distance <= BallCover::kDistanceMin) {
          path.pop_back();
          break;
        }
      }
      const Row rows = correct(cage.tables(), path);
      const size_t n = cage.tables().columns();
      for (size_t i = n; i < rows.size(); ++i) {
        // Changes of some thousandths across the overlap of the smallest cells.
        ASSERT_LT(std::abs(rows[i] - rows[i - n]), 1e-4);
      }
    }
  }
}

TEST(BallTables, SameBitsInAnyOrderByAnyThreadsKeptOrNot) {
  const Prepared cage(testing::bent_prism());
  const std::vector<Vec<3>> points = cage.points(150, 4);
  const BallTables cold = cage.fresh({});
  const Row rows = correct(cold, points);
  EXPECT_EQ(rows, correct(cold, points)) << "warm";

  const BallTables dropping = cage.fresh({.bytes_max = 0}), some = cage.fresh({.bytes_max = 100'000});
  EXPECT_EQ(rows, correct(dropping, points)) << "none kept";
  EXPECT_EQ(dropping.table_count(), 0u);
  EXPECT_EQ(rows, correct(some, points)) << "some kept";
  EXPECT_GT(some.table_count(), 0u);
  EXPECT_LT(some.table_count(), cold.table_count());
  EXPECT_EQ(rows, correct(some, points)) << "some kept, warm";

  const BallTables ahead = cage.fresh({});
  const std::atomic<bool> never = false;
  EXPECT_EQ(ahead.build(1000, never), 1000u);
  EXPECT_EQ(ahead.build(200, never), 200u);
  EXPECT_EQ(ahead.table_count(), 1200u);
  EXPECT_EQ(rows, correct(ahead, points)) << "ahead";
  EXPECT_LT(ahead.table_count(), 1200 + cold.table_count());

  const BallTables single = cage.fresh({});
  const size_t n = single.columns();
  for (size_t i = points.size(); i-- > 0;) {
    const Row row = correct(single, std::span(points).subspan(i, 1));
    ASSERT_TRUE(std::equal(row.begin(), row.end(), rows.begin() + static_cast<std::ptrdiff_t>(i * n))) << i;
  }

  const BallTables shared = cage.fresh({});
  std::vector<Row> of_thread(4);
  {
    std::vector<std::jthread> threads;
    for (Row& result : of_thread) threads.emplace_back([&] { result = correct(shared, points); });
  }
  for (const Row& result : of_thread) EXPECT_EQ(rows, result) << "threads";
  EXPECT_EQ(shared.table_count(), cold.table_count());
  EXPECT_EQ(shared.bytes(), cold.bytes());
}

TEST(BallTables, BytesAreCountedAndBounded) {
  const Prepared cage(testing::box());
  const BallTables tables = cage.fresh({.bytes_max = 50'000});
  const size_t empty = tables.bytes();
  EXPECT_LT(empty, 10'000u);
  correct(tables, cage.points(200, 5));
  const size_t of_table = sizeof(BallTable) + 9 * 16 * sizeof(int16_t);
  EXPECT_EQ(tables.bytes() - tables.cover().bytes(), tables.table_count() * of_table + sizeof(BallTables));
  EXPECT_LE(tables.table_count() * of_table, 50'000u);

  const size_t before = cage.index->bytes();
  std::atomic<bool> cancel = false;
  EXPECT_EQ(cage.index->fill_tables(20, cancel), 20u);
  EXPECT_EQ(cage.tables().table_count(), 20u);
  EXPECT_EQ(cage.index->table_count(), 20u);
  EXPECT_GE(cage.index->bytes(), before + 20 * of_table);
  cancel = true;
  EXPECT_EQ(cage.index->fill_tables(20, cancel), 0u);
}

// Where a single ball serves, values and gradients are of one polynomial.
TEST(BallTables, HaveTheGradientsOfTheirValues) {
  const Prepared cage(testing::bent_prism());
  const BallTables& tables = cage.tables();
  constexpr double kStep = 2e-3;
  size_t checked = 0;
  for (const Vec<3>& x : cage.points(400, 12)) {
    std::vector<Vec<3>> points = {x};
    for (int a = 0; a < 3; ++a)
      for (const double side : {-kStep, kStep}) points.push_back(x + side * Vec<3>::Unit(a));
    std::vector<const BallLeaf*> balls;
    for (const Vec<3>& p : points)
      tables.cover().for_each(p, [&](const BallLeaf& leaf, double) { balls.push_back(&leaf); });
    if (balls.size() != points.size() || std::count(balls.begin(), balls.end(), balls[0]) != 7) continue;
    const std::atomic<bool> never = false;
    BallTables::Workspace workspace;
    const size_t n = tables.columns();
    Row values = correct(tables, points), row(4 * n);
    ASSERT_TRUE(tables.correct(std::span(points).first(1), true, never, workspace, row));
    ++checked;
    for (size_t v = 0; v < n; ++v) {
      EXPECT_EQ(row[v], values[v]);
      for (size_t a = 0; a < 3; ++a)
        EXPECT_NEAR(row[(1 + a) * n + v], (values[(2 + 2 * a) * n + v] - values[(1 + 2 * a) * n + v]) / (2 * kStep),
                    1e-3);
    }
  }
  EXPECT_GT(checked, 20u);
}

TEST(BallTables, CagesThatHaveNoneAreToldApart) {
  for (const testing::Shape& shape : cages()) EXPECT_TRUE(CageIndex::check_tables(shape.input()).ok());
  for (const testing::Shape& shape :
       {testing::open_box(), testing::soup(), testing::square(), testing::sphere(12, 1.0)}) {
    const Status none = CageIndex::check_tables(shape.input());
    ASSERT_FALSE(none.ok());
    EXPECT_EQ(none.error().code, ErrorCode::kInvalidArgument);
    EXPECT_EQ(none.error().field, "tables");
  }
  testing::Shape broken = testing::box();
  broken.quads[0] = 99;
  EXPECT_TRUE(CageIndex::check_tables(broken.input()).error().field.starts_with("cage"));
}

TEST(BallTables, AgreeWithManyWalks) {
  for (const testing::Shape& shape : {testing::bent_prism(), testing::sphere(4, 2.0)}) {
    const Prepared cage(shape);
    std::vector<double> points;
    for (const Vec<3>& x : cage.points(100, 6)) {
      const Vec<3> p = cage.structures().cage.frame().to_caller(x);
      points.insert(points.end(), p.begin(), p.end());
    }
    Options many = with_tables();
    many.tables = false;
    many.samples = 5000;
    const RowBlock walked = testing::bind_or_die(cage.index, testing::loose_points(points), many);
    BindingSummary summary;
    const RowBlock looked_up = testing::bind_or_die(cage.index, testing::loose_points(points), with_tables(), &summary);
    double squared = 0.0;
    for (size_t i = 0; i < walked.row_count(); ++i) {
      const std::vector<double> a = testing::dense_row(walked, i, cage.index->control_vertex_count()),
                                b = testing::dense_row(looked_up, i, cage.index->control_vertex_count());
      for (size_t v = 0; v < a.size(); ++v) squared += (a[v] - b[v]) * (a[v] - b[v]);
    }
    EXPECT_LT(std::sqrt(squared / 100), 2e-3);
    EXPECT_LT(summary.samples, 100u * 12);
    EXPECT_LE(testing::promise_error<3>(*cage.index, points, looked_up).worst(), 1);
  }
}

TEST(BallTables, RowsDependOnNoSeedAwayFromTheCage) {
  const Prepared cage(testing::bent_prism());
  std::vector<double> points;
  for (const Vec<3>& x : cage.points(100, 7)) {
    if (BallTables::part(cage.structures().walks.get()->closest(x).distance) < 1) continue;
    const Vec<3> p = cage.structures().cage.frame().to_caller(x);
    points.insert(points.end(), p.begin(), p.end());
  }
  Options options = with_tables();
  const RowBlock first = testing::bind_or_die(cage.index, testing::loose_points(points), options);
  options.seed = 1;
  options.samples = 3;
  const RowBlock second = testing::bind_or_die(cage.index, testing::loose_points(points), options);
  EXPECT_EQ(first.values, second.values);
}

TEST(BallTables, SameBitsOverVectorWidths) {
  if ((hwy::SupportedTargets() & HWY_AVX3) == 0) GTEST_SKIP() << "this processor has no AVX-512";
  for (const testing::Shape& shape : {testing::bent_prism(), testing::mixed_prism()}) {
    const QueryInput queries = testing::loose_points(testing::random_points(150, 3, -1.0, 1.5, 4));
    Options options = with_tables();
    options.gradients = true;
    const auto bound = [&](int64_t targets) {
      hwy::SetSupportedTargetsForTest(targets);
      const RowBlock rows = testing::bind_or_die(testing::make_index(shape), queries, options);
      hwy::SetSupportedTargetsForTest(0);
      return rows;
    };
    const RowBlock wide = bound(0), narrow = bound(HWY_AVX2);
    EXPECT_EQ(wide.indices, narrow.indices);
    EXPECT_EQ(wide.values, narrow.values);
    EXPECT_EQ(wide.gradients, narrow.gradients);
    EXPECT_EQ(wide.flags, narrow.flags);
  }
}

TEST(BallTables, ElsewherePointsWalk) {
  // Outside, near the cage, and in an open cage rows are those of a request without tables.
  for (const testing::Shape& shape : {testing::box(), testing::open_box()}) {
    const auto index = testing::make_index(shape);
    const std::vector<double> points = {0, 0, 1.5, 0.2, 0.1, -1.3, 0.3, 0.2, 0.999, 0.1, -1, 0.4};
    Options options = with_tables();
    const RowBlock tables = testing::bind_or_die(index, testing::loose_points(points), options);
    options.tables = false;
    EXPECT_EQ(tables.values, testing::bind_or_die(index, testing::loose_points(points), options).values);
  }
}

TEST(BallTables, AreAChoiceWithPredictionsOnly) {
  Options options = with_tables();
  EXPECT_EQ(resolve(options, true)->denoise, Denoise::kNone);
  EXPECT_TRUE(resolve(options, true)->tables);
  options.denoise = Denoise::kMesh;
  EXPECT_EQ(resolve(options, true)->denoise, Denoise::kMesh);
  for (const Estimator estimator : {Estimator::kSampling, Estimator::kBoundaryElement, Estimator::kExact}) {
    Options other;
    other.estimator = estimator;
    if (estimator == Estimator::kExact) other.coordinates = CoordinateKind::kMeanValue;
    EXPECT_TRUE(resolve(other, false).ok());
    other.tables = true;
    const auto refused = resolve(other, false);
    ASSERT_FALSE(refused.ok());
    EXPECT_EQ(refused.error().field, "tables");
  }
}

}  // namespace
}  // namespace barycast
