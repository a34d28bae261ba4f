// Local expansions of sums over panels: against the sums, and the same bits however they are asked for.

#include "solve/local_expansions.h"

#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <hwy/targets.h>
#include <random>

#include "bind/binding.h"
#include "support/boundary_parts.h"
#include "support/panel_rows.h"
#include "support/shapes.h"

namespace barycast {
namespace {

using testing::same;
using testing::Shape;
using testing::solved;

struct Case {
  const char* name;
  Shape shape;
  uint32_t panels;
};
void PrintTo(const Case& some, std::ostream* out) {
  *out << some.name;
}

Shape flat_box(double depth) {
  return testing::box().mapped(
      [&](const Eigen::VectorXd& x) { return Eigen::Vector3d(x[0], x[1], 0.5 * depth * x[2]); });
}

// Of edges that have a cage pass through as many cells as may be.
Shape long_box() {
  return testing::box().mapped(
      [](const Eigen::VectorXd& x) { return Eigen::Vector3d(5.28 * x[0], 4.25 * x[1], 4.25 * x[2]); });
}

// Of coordinates inside a closed cage.
class LocalExpansionsOf : public ::testing::TestWithParam<Case> {
 protected:
  const Cage<3> cage_ = *Cage<3>::create(GetParam().shape.input());
  const BoundaryParts parts_ = solved(cage_, BoundarySides::kInside, GetParam().panels);
  const Panels& panels_ = parts_.kernels.panels();
  const PanelSums sums_{panels_, parts_.data, parts_.densities.inside, &parts_.dipoles};
  const LocalExpansions expansions_{sums_, panels_};

  // All over the box of cells, next to panels, on the faces and corners of cells, and outside of them all.
  std::vector<Vec<3>> places() const {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> uniform(-0.5, 0.5);
    std::vector<Vec<3>> points;
    for (int i = 0; i < 300; ++i) points.push_back(Vec<3>(uniform(random), uniform(random), uniform(random)));
    for (size_t i = 0; i < 100; ++i) {
      const Panel& panel = panels_.panels[i * 7 % panels_.panels.size()];
      const double height = std::pow(10.0, -static_cast<double>(i % 5)) * panel.radius;
      points.push_back(panel.point[i % 3] + (i % 2 == 0 ? height : -height) * panel.normal);
    }
    for (int i = 0; i < 50; ++i) {
      Vec<3> x = points[static_cast<size_t>(i)];
      for (int k = 0; k <= i % 3; ++k) x[k] = std::round(16 * x[k]) / 16;
      points.push_back(x);
    }
    for (int i = 0; i < 20; ++i) points.push_back(4 * points[static_cast<size_t>(i)]);
    return points;
  }

  PanelSums::Rows evaluate(const LocalExpansions& expansions, std::span<const Vec<3>> points, bool gradients) const {
    PanelSums::Rows rows;
    EXPECT_TRUE(expansions.evaluate(points, gradients, kNeverCancelled, rows));
    return rows;
  }
};

TEST_P(LocalExpansionsOf, AreNearlyTheSums) {
  const std::vector<Vec<3>> points = places();
  const PanelSums::Rows rows = evaluate(expansions_, points, true);
  PanelSums::Rows sums;
  sums_.evaluate(points, sums_.column_count(), true, sums);
  double row_squares = 0.0, slope_squares = 0.0, slope_errors = 0.0;
  size_t expanded = 0;
  for (size_t i = 0; i < points.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    const Eigen::RowVectorXf error = rows.values.row(at) - sums.values.row(at);
    const auto where = points[i].transpose();
    if (points[i].cwiseAbs().maxCoeff() > 0.5) {
      EXPECT_TRUE(error.isZero(0)) << where;
      continue;
    }
    // Outside nobody asks: the densities are those of the inside.
    EXPECT_NEAR(rows.enclosed[i], sums.enclosed[i], 1e-3f) << where;
    if (sums.enclosed[i] < 0.25f) continue;
    EXPECT_LT(error.cwiseAbs().maxCoeff(), 8e-4f) << where;
    ++expanded;
    row_squares += double{error.squaredNorm()};
    for (size_t k = 0; k < 3; ++k) {
      slope_errors += double{(rows.gradients[k].row(at) - sums.gradients[k].row(at)).squaredNorm()};
      slope_squares += double{sums.gradients[k].row(at).squaredNorm()};
    }
  }
  EXPECT_GT(row_squares, 0.0) << "nothing was expanded";
  EXPECT_LT(std::sqrt(row_squares / static_cast<double>(expanded)), 1e-4);
  EXPECT_LT(std::sqrt(slope_errors / slope_squares), 1e-3);
}

TEST_P(LocalExpansionsOf, HaveTheSameBitsInEveryList) {
  const std::vector<Vec<3>> points = places();
  for (const bool gradients : {false, true}) {
    const PanelSums::Rows all = evaluate(expansions_, points, gradients);
    for (const size_t size : {1u, 7u, 64u, 130u})
      for (const size_t first : {0u, 5u, 290u, 340u})
        EXPECT_TRUE(same(all, first, evaluate(expansions_, std::span(points).subspan(first, size), gradients))) << size;
    const std::vector<Vec<3>> crowd(150, points[0]);  // more than a batch in one cell
    const PanelSums::Rows of_crowd = evaluate(expansions_, crowd, gradients);
    for (Eigen::Index i = 0; i < 150; ++i) EXPECT_TRUE(of_crowd.values.row(i) == all.values.row(0));
  }
  EXPECT_TRUE(evaluate(expansions_, points, true).values == evaluate(expansions_, points, false).values);
}

// Whether cells are there, or are made by several threads at a time.
TEST_P(LocalExpansionsOf, HaveTheSameBitsWhateverIsThere) {
  const std::vector<Vec<3>> points = places();
  const PanelSums::Rows all = evaluate(expansions_, points, true);
  const LocalExpansions fresh(sums_, panels_);
  for (int twice = 0; twice < 2; ++twice)
    tbb::parallel_for(size_t{0}, points.size(), [&](size_t i) {
      EXPECT_TRUE(same(all, i, evaluate(fresh, std::span(points).subspan(i, 1), true)));
    });
  EXPECT_EQ(fresh.bytes(), expansions_.bytes());
}

// Cells for which there is no memory are larger ones, or none.
TEST_P(LocalExpansionsOf, StayWithinTheirMemory) {
  const std::vector<Vec<3>> points = places();
  PanelSums::Rows sums;
  sums_.evaluate(points, sums_.column_count(), false, sums);
  const size_t empty = LocalExpansions(sums_, panels_, 0).bytes();
  size_t before = empty;
  for (const size_t most : {size_t{0}, size_t{300'000}, size_t{1'000'000}, size_t{3'000'000}}) {
    const LocalExpansions bounded(sums_, panels_, most);
    const PanelSums::Rows rows = evaluate(bounded, points, false);
    EXPECT_LE(bounded.bytes(), empty + most);
    EXPECT_GE(bounded.bytes(), before);
    before = bounded.bytes();
    EXPECT_EQ(rows.values == sums.values, most == 0);
    for (size_t i = 0; i < points.size(); ++i) {
      const auto at = static_cast<Eigen::Index>(i);
      if (sums.enclosed[i] > 0.25f) {
        EXPECT_LT((rows.values.row(at) - sums.values.row(at)).cwiseAbs().maxCoeff(), 8e-4f);
      }
    }
  }
}

// From one cell to the next.
TEST_P(LocalExpansionsOf, HardlyJump) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> uniform(-0.4, 0.4);
  std::vector<Vec<3>> points;
  for (int i = 0; i < 500; ++i) {
    Vec<3> x(uniform(random), uniform(random), uniform(random));
    x[i % 3] = std::round(16 * x[i % 3]) / 16;
    for (const double side : {-1e-9, 1e-9}) points.push_back(x + side * Vec<3>::Unit(i % 3));
  }
  const PanelSums::Rows rows = evaluate(expansions_, points, false);
  size_t inside = 0;
  for (size_t i = 0; i < points.size(); i += 2) {
    if (rows.enclosed[i] < 0.9f) continue;
    ++inside;
    const auto at = static_cast<Eigen::Index>(i);
    EXPECT_LT((rows.values.row(at) - rows.values.row(at + 1)).cwiseAbs().maxCoeff(), 8e-4f) << points[i].transpose();
  }
  EXPECT_GT(inside, 5u);
}

TEST_P(LocalExpansionsOf, HearThatTheyAreCancelled) {
  const LocalExpansions fresh(sums_, panels_);
  const size_t empty = fresh.bytes();
  const std::vector<Vec<3>> points = places();
  PanelSums::Rows rows;
  const std::atomic<bool> cancel = true;
  EXPECT_FALSE(fresh.evaluate(points, true, cancel, rows));
  EXPECT_EQ(fresh.bytes(), empty);
}

TEST_P(LocalExpansionsOf, HaveTheSameBitsOverVectorWidths) {
  if ((hwy::SupportedTargets() & HWY_AVX3) == 0) GTEST_SKIP() << "this processor has no AVX-512";
  const std::vector<Vec<3>> points = places();
  const PanelSums::Rows wide = evaluate(expansions_, points, true);
  hwy::SetSupportedTargetsForTest(HWY_AVX2);
  const LocalExpansions narrow(sums_, panels_);
  const PanelSums::Rows rows = evaluate(narrow, points, true);
  hwy::SetSupportedTargetsForTest(0);
  EXPECT_TRUE(same(wide, 0, rows));
}

// The walls of thin cages carry charges that nearly cancel.
TEST(LocalExpansions, HoldWhereFloatsDo) {
  const auto flat_sphere = [](double depth) {
    return testing::sphere(8, 1.0).mapped(
        [&](const Eigen::VectorXd& x) { return Eigen::Vector3d(x[0], x[1], 0.5 * depth * x[2]); });
  };
  for (const auto& [shape, expected] :
       {std::pair{flat_box(1.0), true}, std::pair{flat_box(0.02), false}, std::pair{flat_box(0.002), false},
        std::pair{flat_sphere(0.6), true}, std::pair{flat_sphere(0.01), false}}) {
    const Cage<3> cage = *Cage<3>::create(shape.input());
    const BoundaryParts parts = solved(cage, BoundarySides::kInside, 600);
    const Panels& panels = parts.kernels.panels();
    EXPECT_EQ(LocalExpansions::hold(PanelSums(panels, parts.data, parts.densities.inside, &parts.dipoles), panels),
              expected);
  }
}

// Points all over ask for all cells that there are.
TEST_P(LocalExpansionsOf, TakeTheBytesThatAreStated) {
  const auto columns = static_cast<size_t>(sums_.column_count());
  Eigen::Array3d least = panels_.panels[0].centre.array(), most = least;
  for (const Panel& panel : panels_.panels)
    for (const Vec<3>& corner : panel.corner) {
      least = least.min(corner.array());
      most = most.max(corner.array());
    }
  std::vector<Vec<3>> points;
  for (int i = 0; i < 30; ++i)
    for (int j = 0; j < 30; ++j)
      for (int k = 0; k < 30; ++k) points.emplace_back(least + (most - least) * Eigen::Array3d(i, j, k) / 29.0);
  const size_t empty = LocalExpansions(sums_, panels_).bytes();
  (void)evaluate(expansions_, points, false);
  EXPECT_LE(expansions_.bytes(), empty + LocalExpansions::most_bytes(points.size(), columns));
  EXPECT_LE(LocalExpansions::expected_bytes(points.size(), columns),
            LocalExpansions::most_bytes(points.size(), columns));
  EXPECT_LE(LocalExpansions::most_bytes(10, columns), LocalExpansions::most_bytes(1000, columns));
}

INSTANTIATE_TEST_SUITE_P(Cages, LocalExpansionsOf,
                         ::testing::Values(Case{"tetrahedron", testing::tetrahedron(), 60},
                                           Case{"box", testing::box(), 300}, Case{"long_box", long_box(), 200},
                                           Case{"bent_prism", testing::bent_prism(), 100},
                                           Case{"flat_box", flat_box(1.0), 300},
                                           Case{"mixed_prism", testing::mixed_prism(), 150},
                                           Case{"sphere", testing::sphere(6, 1.0), 400}),
                         [](const auto& info) { return std::string(info.param.name); });

}  // namespace
}  // namespace barycast
