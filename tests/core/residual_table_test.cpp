// What a prediction misses on the cage, as a table: which functions it reproduces, and that no point of the cage is
// beyond it.

#include "solve/residual_table.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "solve/cuts.h"
#include "support/rows.h"

namespace barycast {
namespace {

using testing::Shape;
using Shares = std::array<double, 4>;

// Nodes on the border are this far inside, in parameters of the element; normalized elements are smaller than one.
constexpr double kInset = 2e-4;

Vec<3> point_at(const Cage<3>& cage, uint32_t element, const Shares& shares) {
  Vec<3> point = Vec<3>::Zero();
  for (int i = 0; i < cage.elements()[element].corner_count(); ++i)
    point += shares[static_cast<size_t>(i)] * cage.corner(cage.elements()[element], i);
  return point;
}

class ResidualTableOf : public ::testing::TestWithParam<std::pair<const char*, Shape>> {
 protected:
  std::shared_ptr<const CageIndex> index_ = *CageIndex::create(GetParam().second.input());
  const Cage<3>& cage_ = std::get<std::unique_ptr<const CageStructures<3>>>(index_->structures())->cage;

  // Of 1, the position, and a quad's u v.
  static constexpr size_t kColumns = 5;
  using Sums = std::array<double, kColumns>;
  Sums exact(uint32_t element, const Shares& shares) const {
    const Vec<3> y = point_at(cage_, element, shares);
    const bool quad = cage_.elements()[element].kind == ElementKind::kQuad;
    return {1.0, y[0], y[1], y[2], quad ? shares[2] : 0.0};
  }

  ResidualTable filled(size_t nodes) const {
    ResidualTable table(cage_, kColumns, nodes);
    for (size_t i = 0; i < table.node_count(); ++i) {
      const ResidualTable::Node node = table.node(i);
      const Sums value = exact(node.element, node.shares);
      for (size_t k = 0; k < kColumns; ++k) table.row(i)[k] = static_cast<float>(value[k]);
    }
    return table;
  }

  // Inside of the element, on its edges and at its corners.
  std::vector<Shares> places(uint32_t element) const {
    std::vector<Shares> result;
    std::mt19937 random(element);
    std::uniform_real_distribution<double> uniform(0, 1);
    const bool quad = cage_.elements()[element].kind == ElementKind::kQuad;
    const auto add = [&](double u, double v) {
      if (quad) {
        result.push_back({(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v});
      } else {
        result.push_back({1 - u, u * (1 - v), u * v, 0.0});
      }
    };
    for (int i = 0; i < 40; ++i) {
      add(uniform(random), uniform(random));
      add(i % 2, uniform(random));
      add(uniform(random), i % 2);
      add(std::pow(10.0, -i), uniform(random));
      add(uniform(random), 1 - std::pow(10.0, -i));
    }
    for (const double u : {0.0, 1.0})
      for (const double v : {0.0, 1.0}) add(u, v);
    return result;
  }
};

TEST_P(ResidualTableOf, ReproducesLinearAndBilinearFunctions) {
  for (const size_t nodes : {1u, 2000u, 100'000u}) {
    const ResidualTable table = filled(nodes);
    for (uint32_t element = 0; element < cage_.elements().size(); ++element)
      for (const Shares& shares : places(element)) {
        const Sums wanted = exact(element, shares);
        Sums sum{};
        table.add(element, shares, 1.0, sum);
        EXPECT_NEAR(sum[0], 1.0, 1e-7);
        for (size_t k = 1; k < kColumns; ++k) ASSERT_NEAR(sum[k], wanted[k], kInset) << element << ", column " << k;
      }
  }
}

TEST_P(ResidualTableOf, SharesThatRoundingPutBeyondTheElementAreThoseOnItsBorder) {
  const ResidualTable table = filled(2000);
  constexpr double kTiny = 1e-15;
  for (uint32_t element = 0; element < cage_.elements().size(); ++element)
    for (Shares shares : places(element)) {
      const Sums wanted = exact(element, shares);
      const size_t corners = static_cast<size_t>(cage_.elements()[element].corner_count());
      for (size_t k = 0; k < corners; ++k) shares[k] += k % 2 == 0 ? kTiny : -kTiny;
      Sums sum{};
      table.add(element, shares, 1.0, sum);
      for (size_t k = 0; k < kColumns; ++k) ASSERT_NEAR(sum[k], wanted[k], kInset) << element << ", column " << k;
    }
}

// Nodes are places of their elements, off the border.
TEST_P(ResidualTableOf, NodesLieInsideOfTheirElements) {
  const ResidualTable table = filled(2000);
  EXPECT_EQ(table.node_count() % cage_.elements().size(), 0u);
  for (size_t i = 0; i < table.node_count(); ++i) {
    const auto [element, shares] = table.node(i);
    ASSERT_LT(element, cage_.elements().size());
    const auto corners = static_cast<size_t>(cage_.elements()[element].corner_count());
    double sum = 0.0;
    for (size_t k = 0; k < corners; ++k) {
      EXPECT_GT(shares[k], 0.0);
      sum += shares[k];
    }
    EXPECT_NEAR(sum, 1.0, 1e-15);
  }
}

TEST_P(ResidualTableOf, AddsAWeightedValueOfTheFirstColumns) {
  const ResidualTable table = filled(2000);
  const Shares middle = places(0)[0];
  Sums once{}, weighted{1, 2, 3, 4, 5};
  table.add(0, middle, 1.0, once);
  table.add(0, middle, -2.5, weighted);
  for (size_t k = 0; k < kColumns; ++k) EXPECT_NEAR(weighted[k], double(k + 1) - 2.5 * once[k], 1e-14);
  std::array<double, 2> first{};
  table.add(0, middle, 1.0, first);
  EXPECT_EQ(first[0], once[0]);
  EXPECT_EQ(first[1], once[1]);
}

TEST_P(ResidualTableOf, HasNoRoughCellsWhereLinesAreExact) {
  ResidualTable table = filled(2000);
  table.find_rough(std::vector<double>(cage_.elements().size(), 1e-6));
  EXPECT_FALSE(table.has_rough());
}

INSTANTIATE_TEST_SUITE_P(Cages, ResidualTableOf,
                         ::testing::Values(std::pair{"box", testing::box()}, std::pair{"bent", testing::bent_prism()},
                                           std::pair{"mixed", testing::mixed_prism()},
                                           std::pair{"soup", testing::soup()},
                                           std::pair{"sphere", testing::sphere(8, 1.0)}),
                         [](const auto& info) { return std::string(info.param.first); });

// A kink next to an edge is what predictions miss: there nodes are close to each other.
TEST(ResidualTable, IsFinerNextToEdges) {
  const auto index = *CageIndex::create(testing::box().input());
  const Cage<3>& cage = std::get<std::unique_ptr<const CageStructures<3>>>(index->structures())->cage;
  ResidualTable table(cage, 1, 2000);
  const auto steep = [](const Shares& shares) { return std::exp(-(shares[0] + shares[3]) / 0.02); };
  for (size_t i = 0; i < table.node_count(); ++i) table.row(i)[0] = static_cast<float>(steep(table.node(i).shares));
  for (int i = 0; i <= 1000; ++i) {
    const double u = i / 1000.0;
    const Shares shares{0.5 * (1 - u), 0.5 * u, 0.5 * u, 0.5 * (1 - u)};
    std::array<double, 1> sum{};
    table.add(3, shares, 1.0, sum);
    EXPECT_NEAR(sum[0], steep(shares), 0.05) << u;
  }
}

// Of a bend the cells that it runs through, on the element that asks for it.
TEST(ResidualTable, FindsTheCellsOfABend) {
  const auto index = *CageIndex::create(testing::box().input());
  const Cage<3>& cage = std::get<std::unique_ptr<const CageStructures<3>>>(index->structures())->cage;
  ResidualTable table(cage, 2, 2000);
  const auto at = [](double u, double v) { return Shares{(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v}; };
  const auto bent = [](const Shares& shares) { return std::max(0.0, shares[1] + shares[2] - 0.43); };
  for (size_t i = 0; i < table.node_count(); ++i) table.row(i)[1] = static_cast<float>(bent(table.node(i).shares));
  std::vector<double> tolerance(cage.elements().size(), 1.0);
  tolerance[3] = 4e-3;
  table.find_rough(tolerance);
  ASSERT_TRUE(table.has_rough());
  for (int i = 0; i <= 100; ++i) {
    EXPECT_TRUE(table.is_rough(3, at(0.43, i / 100.0)));
    EXPECT_FALSE(table.is_rough(3, at(0.25, i / 100.0)));
    EXPECT_FALSE(table.is_rough(3, at(0.60, i / 100.0)));
    EXPECT_FALSE(table.is_rough(2, at(0.43, i / 100.0)));
  }
}

size_t count_of(const Shape& shape, std::vector<uint8_t> (*marked)(const Cage<3>&)) {
  const auto index = *CageIndex::create(shape.input());
  const auto& cage = std::get<std::unique_ptr<const CageStructures<3>>>(index->structures())->cage;
  const std::vector<uint8_t> elements = marked(cage);
  EXPECT_EQ(elements.size(), cage.elements().size());
  return static_cast<size_t>(std::count(elements.begin(), elements.end(), 1));
}

TEST(Cuts, AreElementsThatEdgesOfOthersPassThrough) {
  const auto cut = [](const Shape& shape) { return count_of(shape, cut_elements); };
  for (const Shape& whole : {testing::box(), testing::bent_prism(), testing::mixed_prism(), testing::open_box(),
                             testing::sphere(8, 1.0), testing::joined(testing::box(), testing::small_box(0.1, 0.2, 0))})
    EXPECT_EQ(cut(whole), 0u);
  // Three faces of either box, and the others, which share their corners.
  EXPECT_EQ(cut(testing::joined(testing::box(), testing::small_box(0.8, 0.7, 0.6))), 12u);
}

// To a fiftieth of the diagonal, which is 4.2 where a box lies above another.
TEST(Gaps, AreElementsThatComeClose) {
  const auto close = [](const Shape& shape) { return count_of(shape, close_elements); };
  for (const Shape& whole : {testing::box(), testing::bent_prism(), testing::mixed_prism(), testing::open_box(),
                             testing::sphere(8, 1.0), testing::joined(testing::box(), testing::small_box(0.1, 0.2, 0))})
    EXPECT_EQ(close(whole), 0u);
  const auto boxes = [](double gap) {
    return testing::joined(testing::box(), testing::small_box(0.1, 0.2, 1.5 + gap));
  };
  EXPECT_EQ(close(boxes(0.1)), 0u);
  EXPECT_EQ(close(boxes(0.05)), 6u);  // the face, and all that touches the other box's bottom
  // An edge over an edge, far from all corners.
  const auto crossed = [](double gap) {
    return Shape{.vertices = {-1, 0, 0, 1, 0, 0, 0, -1, -1, 0, -1, gap, 0, 1, gap, 1, 0, gap + 1},
                 .triangles = {0, 1, 2, 3, 4, 5}};
  };
  EXPECT_EQ(close(crossed(0.03)), 2u);
  EXPECT_EQ(close(crossed(0.1)), 0u);
}

}  // namespace
}  // namespace barycast
