// Distances against brute force in double, ties, and radii that never touch the cage.

#include <gtest/gtest.h>

#include <numbers>

#include "query/distance_index.h"
#include "query/element_distance.h"
#include "query/winding.h"
#include "support/mean_value.h"
#include "support/rows.h"

namespace barycast {
namespace {

using testing::Shape;

// Closest point on a patch by alternating exact line searches [SBC App. B] from many starts: slow,
// and nothing in common with the Newton iteration under test.
double brute_patch_distance(const BilinearPatch& patch, const Vec<3>& x) {
  constexpr int kStarts = 12;
  double best = std::numeric_limits<double>::infinity();
  for (int i = 0; i <= kStarts; ++i)
    for (int j = 0; j <= kStarts; ++j) {
      double u = double(i) / kStarts, v = double(j) / kStarts;
      for (int iteration = 0; iteration < 100; ++iteration) {
        const auto along_u = closest_on_segment<3>(x, patch.at(0, v), patch.at(1, v));
        const double moved = std::abs(along_u.shares[1] - u);
        u = along_u.shares[1];
        const auto along_v = closest_on_segment<3>(x, patch.at(u, 0), patch.at(u, 1));
        best = std::min(best, along_v.distance_squared);
        if (moved + std::abs(along_v.shares[1] - v) < 1e-13) break;
        v = along_v.shares[1];
      }
    }
  return std::sqrt(best);
}

template <int D>
double brute_distance(const Cage<D>& cage, const Vec<D>& x, uint32_t* lowest = nullptr) {
  double best = std::numeric_limits<double>::infinity();
  for (uint32_t e = 0; e < cage.elements().size(); ++e) {
    const Element& element = cage.elements()[e];
    double distance = 0.0;
    if constexpr (D == 3) {
      distance = element.kind == ElementKind::kQuad
                     ? brute_patch_distance(patch_of(cage, element), x)
                     : std::sqrt(closest_on_triangle(x, cage.corner(element, 0), cage.corner(element, 1),
                                                     cage.corner(element, 2))
                                     .distance_squared);
    } else {
      distance = std::sqrt(closest_on_segment<2>(x, cage.corner(element, 0), cage.corner(element, 1)).distance_squared);
    }
    if (distance < best) {
      best = distance;
      if (lowest != nullptr) *lowest = e;
    }
  }
  return best;
}

// Closest points, and radii with right and wrong hints, against distances by brute force.
template <int D>
void check_index(const Cage<D>& cage, const DistanceIndex<D>& index, const WalkPositions& at,
                 const std::vector<Vec<D>>& points, const std::vector<double>& brute, double reach) {
  const size_t count = at.count;
  std::vector<uint32_t> hints(count + kWalkLanes, kNoHint);
  std::vector<float> radii(count + kWalkLanes), again(count + kWalkLanes);
  index.free_radii(at, hints.data(), radii.data());
  // Wrong hints, as a walk that jumped far would bring, change nothing.
  std::rotate(hints.begin(), hints.begin() + 1, hints.begin() + static_cast<std::ptrdiff_t>(count));
  index.free_radii(at, hints.data(), again.data());
  const double rounding = 1e-12 * (1 + reach);
  size_t small = 0;
  for (size_t i = 0; i < count; ++i) {
    const CagePoint<D> closest = index.closest(points[i]);
    ASSERT_NEAR(closest.distance, brute[i], rounding) << "point " << i;
    ASSERT_NEAR((closest.point - points[i]).norm(), closest.distance, rounding);
    Vec<D> by_shares = Vec<D>::Zero();
    const Element& element = cage.elements()[closest.element];
    for (int k = 0; k < element.corner_count(); ++k)
      by_shares += closest.shares[static_cast<size_t>(k)] * cage.corner(element, k);
    ASSERT_LT((by_shares - closest.point).norm(), 1e-14);
    ASSERT_LE(double{radii[i]}, brute[i]) << "point " << i;
    small += double{radii[i]} < 0.5 * brute[i] - 2e-3;
    ASSERT_EQ(radii[i], again[i]) << "a hint changed an answer";
  }
  EXPECT_LE(small, 3 * count / 100) << "radii below half the distance";
}

template <int D>
void check_against_brute_force(const Shape& shape, size_t count, double reach) {
  const auto cage = Cage<D>::create(shape.input());
  ASSERT_TRUE(cage.ok()) << cage.error().text();
  const auto grid = make_distance_grid<D>(*cage);
  ASSERT_TRUE(grid.ok());
  const auto embree = make_embree_distance_index<D>(*cage);
  ASSERT_TRUE(embree.ok());
  // Positions as walks have them.
  const auto coordinates = testing::random_points(count, D, -reach, reach, 7);
  std::vector<float> x[3];
  std::vector<Vec<D>> points(count);
  for (auto& axis : x) axis.resize(count + kWalkLanes);
  for (size_t i = 0; i < count; ++i)
    for (int k = 0; k < D; ++k)
      points[i][k] = x[k][i] = static_cast<float>(coordinates[D * i + static_cast<size_t>(k)]);
  const WalkPositions at{x[0].data(), x[1].data(), x[2].data(), count};
  std::vector<double> brute(count);
  for (size_t i = 0; i < count; ++i) brute[i] = brute_distance<D>(*cage, points[i]);
  for (const DistanceIndex<D>* index : {grid->get(), embree->get()}) {
    SCOPED_TRACE(index == grid->get() ? "grid" : "Embree");
    check_index(*cage, *index, at, points, brute, reach);
  }
}

TEST(Distance, MatchesBruteForceOnTriangles) {
  Shape shape = testing::sphere(12, 1.0);
  for (size_t q = 0; q < shape.quads.size(); q += 4)
    for (const size_t k : {0u, 1u, 2u, 0u, 2u, 3u}) shape.triangles.push_back(shape.quads[q + k]);
  shape.quads.clear();
  check_against_brute_force<3>(shape, 2000, 1.0);
}
TEST(Distance, MatchesBruteForceOnPlanarQuads) {
  check_against_brute_force<3>(testing::box(), 400, 1.0);
}
TEST(Distance, MatchesBruteForceOnBilinearQuads) {
  check_against_brute_force<3>(testing::bent_prism(), 150, 0.7);
}
TEST(Distance, MatchesBruteForceOnMixedElements) {
  check_against_brute_force<3>(testing::mixed_prism(), 200, 0.7);
}
TEST(Distance, MatchesBruteForceOnSoup) {
  check_against_brute_force<3>(testing::soup(), 2000, 0.7);
}
TEST(Distance, MatchesBruteForceInThePlane) {
  check_against_brute_force<2>(testing::star_polygon(), 2000, 0.7);
}
TEST(Distance, MatchesBruteForceFarOutside) {
  check_against_brute_force<3>(testing::soup(), 200, 1e4);
  check_against_brute_force<2>(testing::star_polygon(), 200, 1e4);
}

// A strongly twisted patch, and one folded over itself, next to slivers.
TEST(Distance, MatchesBruteForceOnUglyElements) {
  check_against_brute_force<3>({.vertices = {0, 0, 0, 1, 0, 1, 1, 1, 0, 0, 1, 1}, .quads = {0, 1, 2, 3}}, 400, 1.0);
  check_against_brute_force<3>({.vertices = {0, 0, 0, 1, 0, 0.1, 0.2, 0.1, 0.9, 0, 1, 0.1}, .quads = {0, 1, 2, 3}}, 400,
                               1.0);
  check_against_brute_force<3>({.vertices = {0, 0, 0, 1, 0, 0, 0.5, 1e-6, 0, 0.5, 0, 1, 0.4, 0.1, 0.3},
                                .triangles = {0, 1, 2, 0, 1, 3, 1, 3, 4}},
                               1000, 1.0);
}

// Positions everywhere and close to the cage, down to 1e-7, against Embree's closest points in double.
void check_grid(const Shape& shape, size_t count, double reach) {
  const auto cage = Cage<3>::create(shape.input());
  ASSERT_TRUE(cage.ok());
  const auto grid = make_distance_grid<3>(*cage), embree = make_embree_distance_index<3>(*cage);
  ASSERT_TRUE(grid.ok() && embree.ok());
  const auto coordinates = testing::random_points(count, 3, -reach, reach, 13);
  std::vector<float> x[3], radii(count + kWalkLanes);
  std::vector<uint32_t> hints(count + kWalkLanes, kNoHint);
  for (auto& axis : x) axis.resize(count + kWalkLanes);
  for (size_t i = 0; i < count; ++i) {
    Vec<3> point = Eigen::Map<const Vec<3>>(coordinates.data() + 3 * i);
    if (i % 2 == 0) {
      const CagePoint<3> on = (*embree)->closest(point);
      point = on.point + std::pow(10.0, -double(i % 7) - 1) * (point - on.point).normalized();
    }
    for (int k = 0; k < 3; ++k) x[k][i] = static_cast<float>(point[k]);
  }
  (*grid)->free_radii({x[0].data(), x[1].data(), x[2].data(), count}, hints.data(), radii.data());
  double bound_sum = 0.0, distance_sum = 0.0;
  size_t small = 0;
  for (size_t i = 0; i < count; ++i) {
    const Vec<3> point(x[0][i], x[1][i], x[2][i]);
    const CagePoint<3> closest = (*embree)->closest(point);
    ASSERT_LE(double{radii[i]}, closest.distance) << "point " << i;
    small += double{radii[i]} < 0.5 * closest.distance - 2e-3;
    ASSERT_NEAR((*grid)->closest(point).distance, closest.distance, 1e-12 * (1 + reach)) << "point " << i;
    for (const double within : {1.0, 1.5})
      for (const auto* index : {&*grid, &*embree}) {
        const CagePoint<3> all = (*index)->closest(point), some = (*index)->closest(point, within * all.distance);
        ASSERT_TRUE(some.element == all.element && some.point == all.point && some.shares == all.shares);
      }
    // Patches and triangles that stand for them deviate by 2.5 percent of the distance, and by 2.4e-4 next to them.
    const double clear = (*grid)->free_radius(point);
    ASSERT_LE(clear, closest.distance);
    ASSERT_GE(clear, 0.93 * closest.distance - 6e-4) << "point " << i;
    bound_sum += double{radii[i]};
    distance_sum += closest.distance;
  }
  std::vector<uint32_t> walks;  // some of them, in another order
  for (size_t i = 0; i < count; i += 3) walks.push_back(static_cast<uint32_t>(count - 1 - i));
  std::vector<CagePoint<3>> ends(walks.size());
  for (const double tolerance : {1e-2, 5e-4, 1e-5}) {
    (*grid)->near({x[0].data(), x[1].data(), x[2].data(), count}, walks, tolerance, ends);
    for (size_t k = 0; k < walks.size(); ++k) {
      const Vec<3> point(x[0][walks[k]], x[1][walks[k]], x[2][walks[k]]);
      const double distance = (*embree)->closest(point).distance;
      ASSERT_NEAR(ends[k].distance, (ends[k].point - point).norm(), 1e-14);
      ASSERT_GE(ends[k].distance, distance - 1e-12);
      ASSERT_LE(ends[k].distance, distance + tolerance) << "point " << walks[k];
      const Element& element = cage->elements()[ends[k].element];
      Vec<3> by_shares = Vec<3>::Zero();
      for (int c = 0; c < element.corner_count(); ++c)
        by_shares += ends[k].shares[static_cast<size_t>(c)] * cage->corner(element, c);
      ASSERT_LE((by_shares - ends[k].point).norm(), 1e-15 * (1 + reach));
      ASSERT_GE(*std::min_element(ends[k].shares.begin(), ends[k].shares.end()), 0.0);
    }
  }
  EXPECT_GE(bound_sum, 0.85 * distance_sum);
  EXPECT_LE(small, 3 * count / 100) << "radii below half the distance";
}

TEST(Distance, GridAgreesWithEmbree) {
  for (const Shape& shape : {testing::triangulated(testing::sphere(12, 1.0)), testing::box(), testing::bent_prism(),
                             testing::mixed_prism(), testing::open_box(), testing::soup(), testing::collapsed_box()})
    for (const double reach : {0.6, 3.0}) check_grid(shape, 20'000, reach);
  const Shape twisted{.vertices = {0, 0, 0, 1, 0, 1, 1, 1, 0, 0, 1, 1}, .quads = {0, 1, 2, 3}};
  const Shape folded{.vertices = {0, 0, 0, 1, 0, 0.1, 0.2, 0.1, 0.9, 0, 1, 0.1}, .quads = {0, 1, 2, 3}};
  const Shape slivers{.vertices = {0, 0, 0, 1, 0, 0, 0.5, 1e-6, 0, 0.5, 0, 1, 0.4, 0.1, 0.3},
                      .triangles = {0, 1, 2, 0, 1, 3, 1, 3, 4}};
  for (const Shape& shape : {twisted, folded, slivers}) check_grid(shape, 20'000, 0.6);
}

// Many triangles around one edge: more than a cell can list.
TEST(Distance, GridAgreesWithEmbreeWhereEverythingMeets) {
  Shape fan{.vertices = {0, 0, -0.5, 0, 0, 0.5}};
  for (uint32_t i = 0; i < 2000; ++i) {
    const double angle = 2 * std::numbers::pi * i / 2000;
    fan.vertices.insert(fan.vertices.end(), {std::cos(angle), std::sin(angle), 0});
    fan.triangles.insert(fan.triangles.end(), {0, 1, 2 + i});
  }
  check_grid(fan, 4000, 0.5);
}

// Corners in one place, or nearly: by closest points on the patch's rulings, which are straight.
TEST(Distance, FindsTheClosestPointOfQuadsWithCoincidingCorners) {
  const auto numbers = testing::random_points(40, 3, -1, 1, 19);
  const auto at = [&](size_t i) { return Vec<3>(Eigen::Map<const Vec<3>>(numbers.data() + 3 * i)); };
  double worst = 0.0;
  for (size_t q = 0; q < 8; ++q)
    for (const double apart : {0.0, 1e-9, 1e-3}) {
      const Vec<3> a = at(3 * q), b = at(3 * q + 1), c = at(3 * q + 2), beside = a + apart * (c - b);
      const BilinearPatch patch = q % 2 == 0 ? BilinearPatch{{a, beside, b, c}} : BilinearPatch{{a, b, c, beside}};
      const auto queries = testing::random_points(200, 3, -2, 2, 23);
      for (size_t i = 0; i < 200; ++i) {
        const Vec<3> x = Eigen::Map<const Vec<3>>(queries.data() + 3 * i);
        double brute = std::numeric_limits<double>::infinity();
        for (int k = 0; k <= 2000; ++k) {
          const double u = k / 2000.0;
          brute = std::min(brute, closest_on_segment<3>(x, patch.at(u, 0), patch.at(u, 1)).distance_squared);
        }
        const double found = std::sqrt(closest_on_patch(x, patch, PatchWindow{}).distance_squared);
        worst = std::max(worst, found - std::sqrt(brute));
      }
    }
  EXPECT_LT(worst, 1e-4);
}

// Any number of triangles anywhere: the work and the memory of the grid are bounded, and answers stay right.
TEST(Distance, GridOfADenseSoupIsBounded) {
  constexpr uint32_t kTriangles = 20'000;
  const auto numbers = testing::random_points(4 * kTriangles, 3, -0.5, 0.5, 29);
  Shape soup;
  for (uint32_t i = 0; i < kTriangles; ++i)
    for (uint32_t k = 0; k < 3; ++k) {
      for (uint32_t axis = 0; axis < 3; ++axis)
        soup.vertices.push_back(numbers[12 * i + axis] + 0.5 * numbers[12 * i + 3 * (k + 1) + axis]);
      soup.triangles.push_back(3 * i + k);
    }
  const auto cage = Cage<3>::create(soup.input());
  ASSERT_TRUE(cage.ok());
  const auto grid = make_distance_grid<3>(*cage), embree = make_embree_distance_index<3>(*cage);
  ASSERT_TRUE(grid.ok() && embree.ok());
  EXPECT_LT((*grid)->bytes() - (*embree)->bytes(), size_t{64} << 20);
  check_grid(soup, 400, 0.6);
}

TEST(Distance, RefusesMoreTwistedQuadsThanItCanHold) {
  Shape twisted{.vertices = {0, 0, 0, 1, 0, 1, 1, 1, 0, 0, 1, 1}};
  for (int i = 0; i < 5000; ++i) twisted.quads.insert(twisted.quads.end(), {0, 1, 2, 3});
  const auto cage = Cage<3>::create(twisted.input());
  ASSERT_TRUE(cage.ok());
  const auto index = make_embree_distance_index<3>(*cage);
  ASSERT_FALSE(index.ok());
  EXPECT_EQ(index.error().code, ErrorCode::kResourceExhausted);
  // What a cost estimate asks, without building anything.
  const Status checked = CageIndex::check(twisted.input());
  ASSERT_FALSE(checked.ok());
  EXPECT_EQ(checked.error().text(), index.error().text());
}

TEST(Distance, TiesGoToTheLowestElement) {
  Shape twice = testing::box();
  twice.quads.insert(twice.quads.end(), twice.quads.begin(), twice.quads.begin() + 24);
  const auto cage = Cage<3>::create(twice.input());
  ASSERT_TRUE(cage.ok());
  const auto index = make_embree_distance_index<3>(*cage);
  ASSERT_TRUE(index.ok());
  EXPECT_EQ((*index)->closest(Vec<3>::Zero()).element, 0u);  // all twelve are equally near
  const auto coordinates = testing::random_points(300, 3, -0.25, 0.25, 3);
  for (size_t i = 0; i < 300; ++i)
    EXPECT_LT((*index)->closest(Eigen::Map<const Vec<3>>(coordinates.data() + 3 * i)).element, 6u);
}

TEST(Distance, TrianglePairsGiveTightLowerBounds) {
  const auto c = testing::random_points(6000, 3, -1, 1, 5);
  for (size_t i = 0; i < 1000; ++i) {
    const auto at = [&](size_t k) { return Vec<3>(Eigen::Map<const Vec<3>>(c.data() + 3 * (6 * i + k))); };
    // Every third first triangle is a sliver, of heights down to none.
    const double height = std::pow(10.0, -double(i % 20));
    const Vec<3> third = i % 3 == 0 ? Vec<3>(0.3 * at(0) + 0.7 * at(1) + (i % 20 == 19 ? 0 : height) * at(2)) : at(2);
    const TrianglePairDistance pair({at(0), at(1), third}, {at(0), third, at(3)});
    const Vec<3> x = i % 2 == 0 ? at(4) : Vec<3>(100 * at(4));
    const double exact = std::sqrt(std::min(closest_on_triangle(x, at(0), at(1), third).distance_squared,
                                            closest_on_triangle(x, at(0), third, at(3)).distance_squared));
    EXPECT_LE(pair.lower_bound(x), exact) << i;
    EXPECT_GE(pair.lower_bound(x), exact - 1e-5 * (exact + 2)) << i;
  }
}

// From a corner of a cube an eighth of all directions lead inside; the facets that end there say nothing of them.
TEST(Winding, CountsTheOtherFacetsAtAVertex) {
  const auto cage = Cage<3>::create(testing::box().input());
  ASSERT_TRUE(cage.ok());
  const WindingNumber<3> winding(*cage);
  for (const Vec<3>& corner : cage->control_vertices()) EXPECT_NEAR(winding(corner), 0.125, 1e-9);
}

TEST(Winding, TellsInsideFromOutside) {
  const auto cage = Cage<3>::create(testing::sphere(24, 1.0).input());  // more facets than a leaf holds
  ASSERT_TRUE(cage.ok());
  const WindingNumber<3> winding(*cage);
  const auto coordinates = testing::random_points(2000, 3, -0.7, 0.7, 11);
  for (size_t i = 0; i < 2000; ++i) {
    const Vec<3> x = Eigen::Map<const Vec<3>>(coordinates.data() + 3 * i);
    const double radius = x.norm() * cage->frame().diagonal;
    if (std::abs(radius - 1) > 0.02) {
      EXPECT_NEAR(winding(x), radius < 1 ? 1.0 : 0.0, 0.03);
    }
  }
  const auto polygon = Cage<2>::create(testing::star_polygon().input());
  ASSERT_TRUE(polygon.ok());
  const WindingNumber<2> turns(*polygon);
  EXPECT_TRUE(turns.inside(polygon->frame().to_normalized(Vec<2>(0.1, 0.2))));
  EXPECT_FALSE(turns.inside(polygon->frame().to_normalized(Vec<2>(0.75, 0.5))));
}

}  // namespace
}  // namespace barycast
