// Sums over panels in floats: against those in doubles, and the same bits however they are asked for.

#include "solve/panel_sums.h"

#include <gtest/gtest.h>

#include <hwy/targets.h>
#include <cmath>
#include <random>

#include "solve/panel_kernels.h"
#include "support/panel_rows.h"
#include "support/shapes.h"

namespace barycast {
namespace {

using testing::same;
using testing::Shape;

struct Case {
  const char* name;
  Shape shape;
  uint32_t panels;
  bool moments, dipoles;
};
void PrintTo(const Case& some, std::ostream* out) {
  *out << some.name;
}

std::vector<Case> cases() {
  return {
      {"tetrahedron", testing::tetrahedron(), 60, false, true}, {"box", testing::box(), 120, false, true},
      {"mixed_prism", testing::mixed_prism(), 150, true, true}, {"bent_prism", testing::bent_prism(), 100, true, false},
      {"open_box", testing::open_box(), 90, true, false},       {"soup", testing::soup(), 48, true, false}};
}

class PanelSumsOf : public ::testing::TestWithParam<Case> {
 protected:
  // By row: values and three partial derivatives.
  struct Expected {
    DoubleLayer::Rows rows;
    double enclosed;
  };

  const Case& some_ = GetParam();
  const Cage<3> cage_ = *Cage<3>::create(some_.shape.input());
  PanelKernels kernels_{*Panels::cut(cage_, some_.panels)};
  BoundaryData data_{cage_, some_.moments};
  DoubleLayer dipoles_{cage_, kernels_.panels(), data_};
  // Rougher than solved ones.
  DensityGroups densities_ = [this] {
    std::mt19937 random(1);
    std::uniform_real_distribution<double> uniform(-1, 1);
    DensityGroups groups(some_.dipoles ? DensityColumn::groups(data_.basis_count()) : DensityColumn::groups(data_));
    for (auto& group : groups) {
      group.resize(kernels_.point_count(), kDensityGroup);
      for (double& density : group.reshaped()) density = uniform(random);
    }
    return groups;
  }();
  PanelSums sums_{kernels_.panels(), data_, densities_, some_.dipoles ? &dipoles_ : nullptr};

  const std::vector<Panel>& panels() const { return kernels_.panels().panels; }

  PanelSums::Rows evaluate(std::span<const Vec<3>> points, bool gradients) const {
    PanelSums::Rows rows;
    sums_.evaluate(points, sums_.column_count(), gradients, rows);
    return rows;
  }

  Expected in_doubles(const Vec<3>& x) const {
    PanelKernels::Tables tables(kernels_.point_count());
    kernels_.fill(x, 0, true, true, tables);
    Expected expected{DoubleLayer::Rows::Zero(4, sums_.column_count()), 0.0};
    for (Eigen::Index column = 0; column < sums_.column_count(); ++column) {
      const DensityColumn at(column, data_);
      expected.rows.col(column) = tables.charges * densities_[at.group].col(at.lane);
    }
    Eigen::Array4d enclosed = Eigen::Array4d::Zero();
    if (some_.dipoles) dipoles_.add(tables.dipoles, expected.rows, enclosed);
    expected.enclosed = enclosed[0];
    return expected;
  }

  // Everywhere: around the cage, far away, and as near to the middle of panels as a billionth of a diagonal.
  std::vector<Vec<3>> places() const {
    std::mt19937 random(2);
    std::uniform_real_distribution<double> uniform(-0.7, 0.7);
    std::vector<Vec<3>> points;
    for (int i = 0; i < 70; ++i) points.push_back(Vec<3>(uniform(random), uniform(random), uniform(random)));
    for (int i = 0; i < 10; ++i) points.push_back(10 * points[static_cast<size_t>(i)]);
    for (size_t i = 0; i < 80; ++i) {
      const Panel& panel = panels()[i * 7 % panels().size()];
      const double height = std::pow(10.0, -static_cast<double>(i % 9)) * panel.radius;
      points.push_back(panel.point[i % 3] + (i % 2 == 0 ? height : -height) * panel.normal);
    }
    return points;
  }
};

TEST_P(PanelSumsOf, AreThoseInDoubles) {
  const std::vector<Vec<3>> points = places();
  const PanelSums::Rows rows = evaluate(points, true);
  std::vector<Expected> expected;
  double squares = 0.0;
  for (const Vec<3>& x : points) {
    expected.push_back(in_doubles(x));
    squares += expected.back().rows.bottomRows<3>().squaredNorm();
  }
  const double rms =
      std::sqrt(squares / static_cast<double>(points.size() * static_cast<size_t>(sums_.column_count())));
  for (size_t i = 0; i < points.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    const auto error = [&](const PanelSums::Rows::Table& table, Eigen::Index row) {
      return (table.row(at).cast<double>() - expected[i].rows.row(row)).cwiseAbs().maxCoeff();
    };
    EXPECT_LT(error(rows.values, 0), 1e-5) << points[i].transpose();
    for (size_t k = 0; k < 3; ++k)
      EXPECT_LT(error(rows.gradients[k], static_cast<Eigen::Index>(1 + k)), 1e-3 * rms) << points[i].transpose();
    if (some_.dipoles) {
      EXPECT_NEAR(rows.enclosed[i], expected[i].enclosed, 1e-5) << points[i].transpose();
    }
  }
}

// There the dipoles' potential is the mean of both sides, even where rounding puts a point on one of them.
TEST_P(PanelSumsOf, OnPanelsAreTheMeanOfBothSides) {
  for (size_t p = 0; p < panels().size(); p += 5) {
    const Panel& panel = panels()[p];
    const std::vector<Vec<3>> points = {panel.point[p % 3]};
    const PanelSums::Rows rows = evaluate(points, true);
    const Expected above = in_doubles(points[0] + 1e-9 * panel.normal),
                   below = in_doubles(points[0] - 1e-9 * panel.normal);
    const auto mean = 0.5 * (above.rows + below.rows);
    EXPECT_LT((rows.values.cast<double>() - mean.row(0)).cwiseAbs().maxCoeff(), 1e-5);
    for (Eigen::Index k = 0; k < 3; ++k)
      EXPECT_LT((rows.gradients[static_cast<size_t>(k)].cast<double>() - mean.row(1 + k)).cwiseAbs().maxCoeff(), 1e-2);
    if (some_.dipoles) {
      EXPECT_NEAR(rows.enclosed[0], 0.5, 1e-5);
    }
  }
}

// Values there are bounded; gradients are infinite, and large.
TEST_P(PanelSumsOf, OnEdgesAreFinite) {
  std::vector<Vec<3>> points;
  for (size_t p = 0; p < panels().size(); p += 7)
    for (const double along : {0.0, 0.3, 0.5, 1.0})
      points.push_back((1 - along) * panels()[p].corner[0] + along * panels()[p].corner[1]);
  const PanelSums::Rows rows = evaluate(points, true);
  for (const auto& partial : rows.gradients) EXPECT_TRUE(partial.allFinite());
  EXPECT_TRUE(rows.values.allFinite());
  // Single layers are continuous; what dipoles are on an edge of the cage is a matter of rounding.
  if (some_.dipoles) return;
  for (size_t i = 0; i < points.size(); ++i) {
    const auto row = rows.values.row(static_cast<Eigen::Index>(i)).cast<double>();
    EXPECT_LT((row - in_doubles(points[i]).rows.row(0)).cwiseAbs().maxCoeff(), 1e-5) << points[i].transpose();
  }
}

TEST_P(PanelSumsOf, HaveTheSameBitsInEveryBatch) {
  const std::vector<Vec<3>> points = places();
  for (const bool gradients : {false, true}) {
    const PanelSums::Rows all = evaluate(points, gradients);
    for (const size_t size : {1u, 7u, 17u, 64u})
      for (const size_t first : {0u, 5u, 90u})
        EXPECT_TRUE(same(all, first, evaluate(std::span(points).subspan(first, size), gradients))) << size;
  }
}

TEST_P(PanelSumsOf, HaveTheSameBitsWithoutGradientsAndForFewerColumns) {
  const std::vector<Vec<3>> points = places();
  const PanelSums::Rows all = evaluate(points, true);
  EXPECT_TRUE(all.values == evaluate(points, false).values);
  for (const Eigen::Index columns : {Eigen::Index{3}, data_.basis_count(), sums_.column_count()}) {
    PanelSums::Rows some;
    sums_.evaluate(points, columns, true, some);
    EXPECT_TRUE(all.values.leftCols(columns) == some.values);
    for (size_t k = 0; k < 3; ++k) EXPECT_TRUE(all.gradients[k].leftCols(columns) == some.gradients[k]);
  }
}

TEST_P(PanelSumsOf, HaveTheSameBitsOverVectorWidths) {
  if ((hwy::SupportedTargets() & HWY_AVX3) == 0) GTEST_SKIP() << "this processor has no AVX-512";
  const std::vector<Vec<3>> points = places();
  const PanelSums::Rows wide = evaluate(points, true);
  hwy::SetSupportedTargetsForTest(HWY_AVX2);
  const PanelSums::Rows narrow = evaluate(points, true);
  hwy::SetSupportedTargetsForTest(0);
  EXPECT_TRUE(same(wide, 0, narrow));
}

INSTANTIATE_TEST_SUITE_P(Cages, PanelSumsOf, ::testing::ValuesIn(cases()),
                         [](const auto& info) { return std::string(info.param.name); });

}  // namespace
}  // namespace barycast
