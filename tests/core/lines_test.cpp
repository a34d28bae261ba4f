// What a line meets of a cage: every element once, none lost or doubled at edges and vertices, whatever the
// accelerator proposes.

#include <gtest/gtest.h>

#include <algorithm>
#include <tuple>

#include "query/distance_index.h"
#include "query/element_distance.h"
#include "query/line_index.h"
#include "query/winding.h"
#include "support/mean_value.h"
#include "support/rows.h"

namespace barycast {
namespace {

using testing::Shape;

const CageStructures<3>& structures_of(const CageIndex& index) {
  return *std::get<std::unique_ptr<const CageStructures<3>>>(index.structures());
}

template <int D>
struct Line {
  Vec<D> origin, direction;
};

// Every element tried, in the order that the index promises.
std::vector<LineHit<3>> by_force(const Cage<3>& cage, const Line<3>& line, double from) {
  std::vector<LineHit<3>> all;
  std::array<LineHit<3>, 2> found;
  for (uint32_t e = 0; e < cage.elements().size(); ++e) {
    const int count = meet(line.origin, line.direction, cage, e, found);
    for (int i = 0; i < count; ++i)
      if (found[static_cast<size_t>(i)].t > from) all.push_back(found[static_cast<size_t>(i)]);
  }
  std::stable_sort(all.begin(), all.end(),
                   [](const auto& a, const auto& b) { return std::tie(a.t, a.element) < std::tie(b.t, b.element); });
  return all;
}

// Points that lines are aimed at: vertices of the cage, points of its elements' edges (some exact, some
// rounded), points inside elements.
std::vector<Vec<3>> targets(const Cage<3>& cage) {
  std::vector<Vec<3>> result(cage.control_vertices().begin(), cage.control_vertices().end());
  for (const Element& element : cage.elements())
    for (int i = 0; i < element.corner_count(); ++i) {
      const Vec<3>&a = cage.corner(element, i), &b = cage.corner(element, (i + 1) % element.corner_count());
      for (const double share : {0.5, 0.25, 0.1, 1e-7, 1e-15}) result.push_back(share * a + (1 - share) * b);
    }
  return result;
}

std::vector<Vec<3>> origins(const Cage<3>& cage) {
  std::vector<Vec<3>> result = {Vec<3>::Zero(), {0.11, -0.05, 0.07}, {0.9, 0.8, -0.7},
                                {0, 0, 3},      {5, 0, 0},           {0, 1e4, 1e4}};
  // In the plane of a face, and in line with an edge.
  const Element& element = cage.elements()[0];
  const Vec<3>&a = cage.corner(element, 0), &b = cage.corner(element, 1), &c = cage.corner(element, 2);
  result.push_back(a + 3 * (b - a));
  result.push_back(a + 2 * (b - a) + 3 * (c - a));
  return result;
}

Shape tiny() {
  Shape shape = testing::tetrahedron();
  for (double& x : shape.vertices) x = 0.3 + 2e-9 * x;
  return shape;
}

struct Case {
  const char* name;
  Shape shape;
};

const std::vector<Case>& closed_cages() {
  static const std::vector<Case> cases = {
      {"tetrahedron", testing::tetrahedron()},
      {"box of quads", testing::box()},
      {"box of triangles", testing::triangulated(testing::box())},
      {"bent prism of bilinear quads", testing::bent_prism()},
      {"bent prism of triangles", testing::triangulated(testing::bent_prism())},
      {"mixed prism", testing::mixed_prism()},
      {"sphere", testing::sphere(8, 1.0)},
      {"torn soup turned closed: twice the same sphere",
       [] {
         Shape shape = testing::triangulated(testing::sphere(5, 1.0));
         const auto copy = shape.triangles;
         shape.triangles.insert(shape.triangles.end(), copy.begin(), copy.end());
         return shape;
       }()},
  };
  return cases;
}

// In order.
template <int D>
void hits_of(const LineIndex<D>& lines, const Line<D>& line, double from, std::vector<LineHit<D>>& out) {
  LineHits<D> hits;
  lines.hits(line.origin, {&line.direction, 1}, from, hits);
  out.clear();
  for (const uint32_t hit : hits.of_line(0)) out.push_back(hits.hits[hit]);
}

// The line from an origin through a target.
Line<3> aimed(const Vec<3>& origin, const Vec<3>& target) {
  return {origin, (target - origin).normalized()};
}

TEST(Lines, MeetClosedCagesAnEvenNumberOfTimes) {
  std::vector<LineHit<3>> hits;
  for (const Case& c : closed_cages()) {
    const auto index = testing::make_index(c.shape);
    const CageStructures<3>& structures = structures_of(*index);
    size_t lines = 0;
    for (const Vec<3>& origin : origins(structures.cage))
      for (const Vec<3>& target : targets(structures.cage)) {
        if ((target - origin).norm() < 1e-3) continue;
        hits_of(*structures.lines, aimed(origin, target), -1e9, hits);
        ASSERT_EQ(hits.size() % 2, 0u) << c.name << " from " << origin.transpose() << " at " << target.transpose();
        ++lines;
      }
    EXPECT_GT(lines, 100u) << c.name;
  }
}

// The normals of the hits count how deep inside the line is: what the winding number says between two hits.
// A half line starts inside exactly if it has an odd number of hits.
TEST(Lines, CountDepthAsTheWindingNumberDoes) {
  std::vector<LineHit<3>> hits;
  for (const Case& c : closed_cages()) {
    if (std::string(c.name).starts_with("torn")) continue;
    const auto index = testing::make_index(c.shape);
    const CageStructures<3>& structures = structures_of(*index);
    size_t depths = 0;
    for (const Vec<3>& origin : origins(structures.cage)) {
      const double clearance = (*structures.walks).closest(origin).distance;
      if (clearance < 1e-6) continue;
      const bool inside = structures.winding->inside(origin);
      for (const Vec<3>& target : targets(structures.cage)) {
        const Line<3> line = aimed(origin, target);
        hits_of(*structures.lines, line, 0.0, hits);
        ASSERT_EQ(hits.size() % 2 == 1, inside)
            << c.name << " from " << origin.transpose() << " at " << target.transpose();
        for (const LineHit<3>& hit : hits) {
          EXPECT_NEAR((hit.point - origin).cross(line.direction).norm(), 0.0, 1e-9 * (1 + origin.norm()));
          EXPECT_NEAR((hit.point - origin).dot(line.direction), hit.t, 1e-12 * (1 + origin.norm()));
          double share_sum = 0.0;
          for (const double share : hit.shares) {
            EXPECT_GE(share, 0.0);
            share_sum += share;
          }
          EXPECT_NEAR(share_sum, 1.0, 1e-14);
        }
        double depth = inside ? 1 : 0;
        for (size_t i = 0; i + 1 < hits.size(); ++i) {
          const Element& element = structures.cage.elements()[hits[i].element];
          const Vec<3> normal = element_normal(structures.cage, element, hits[i].shares);
          const double across = structures.cage.orientation() * normal.dot(line.direction);
          if (std::abs(across) < 1e-6) break;  // along a face: the normal does not say
          depth += across < 0 ? 1 : -1;
          const Vec<3> middle = (hits[i].point + hits[i + 1].point) / 2;
          // Winding numbers are of flat halves of patches, and not to be asked close by.
          if ((*structures.walks).closest(middle).distance < 0.03) continue;
          EXPECT_NEAR(std::abs((*structures.winding)(middle)), depth, 0.1)
              << c.name << " after hit " << i << " of " << hits.size() << " from " << origin.transpose() << " at "
              << target.transpose();
          ++depths;
        }
      }
    }
    EXPECT_GT(depths, 30u) << c.name;
  }
}

TEST(Lines, AreTheSameWithEveryEngineAndWithout) {
  std::vector<LineHit<3>> hits;
  std::vector<Case> cases = closed_cages();
  cases.push_back({"open box", testing::open_box()});
  cases.push_back({"soup", testing::soup()});
  cases.push_back({"box, and a tetrahedron that floats take for a point", testing::joined(testing::box(), tiny())});
  const auto directions = testing::random_points(300, 3, -1, 1, 5);
  for (const Case& c : cases) {
    const auto cage_index = testing::make_index(c.shape);
    const CageStructures<3>& structures = structures_of(*cage_index);
    size_t met = 0;
    const auto embree = make_embree_line_index<3>(structures.cage), sweep = make_line_sweep(structures.cage);
    ASSERT_TRUE(embree.ok() && sweep.ok());
    const auto compare = [&](const Line<3>& line, double from) {
      const auto expected = by_force(structures.cage, line, from);
      met += expected.size();
      for (const auto* index : {embree->get(), sweep->get()}) {
        hits_of(*index, line, from, hits);
        ASSERT_EQ(hits.size(), expected.size()) << c.name;
        for (size_t i = 0; i < hits.size(); ++i) {
          EXPECT_EQ(hits[i].t, expected[i].t);
          EXPECT_EQ(hits[i].element, expected[i].element);
          EXPECT_EQ(hits[i].point, expected[i].point);
        }
      }
    };
    for (const Vec<3>& origin : origins(structures.cage)) {
      for (const Vec<3>& target : targets(structures.cage))
        if (target != origin) compare(aimed(origin, target), -1e9);
      for (size_t i = 0; i < directions.size(); i += 3) {
        const Vec<3> direction = Eigen::Map<const Vec<3>>(directions.data() + i).normalized();
        compare({origin, direction}, 0.0);
        compare({origin, direction}, -1e9);
      }
    }
    EXPECT_GT(met, 1000u) << c.name;
  }
}

TEST(Lines, MeetEdgesOfPolygonsOnce) {
  const auto index = testing::make_index(testing::star_polygon());
  const auto& structures = *std::get<std::unique_ptr<const CageStructures<2>>>(index->structures());
  std::vector<LineHit<2>> hits;
  for (const Vec<2>& origin : {Vec<2>(0, 0), Vec<2>(0.05, 0.02), Vec<2>(3, 0), Vec<2>(0, -1e5)})
    for (const Vec<2>& vertex : structures.cage.control_vertices()) {
      const Line<2> line(origin, (vertex - origin).normalized());
      hits_of(*structures.lines, line, -1e9, hits);
      EXPECT_EQ(hits.size() % 2, 0u);
      hits_of(*structures.lines, line, 0.0, hits);
      EXPECT_EQ(hits.size() % 2 == 1, structures.winding->inside(origin));
    }
}

// A patch that folds as seen along the line is met twice; one that bulges past it, not at all.
TEST(Lines, MeetAFoldedPatchTwiceOrNever) {
  Shape shape;
  shape.vertices = {0, 0, 1, 1, 0, 0, 1, 1, 1, 0, 1, 0, 0.5, 0.5, 3};
  shape.quads = {0, 1, 2, 3};
  shape.triangles = {0, 1, 4};
  const auto index = testing::make_index(shape);
  const CageStructures<3>& structures = structures_of(*index);
  std::array<LineHit<3>, 2> found;
  uint32_t quad = 0;
  while (structures.cage.elements()[quad].kind != ElementKind::kQuad) ++quad;
  size_t twice = 0, never = 0;
  const auto heights = testing::random_points(200, 1, 0.0, 1.0, 3);
  for (const double height : heights) {
    // Across a diagonal of the saddle, near its ridge.
    const Vec<3> from = structures.cage.frame().to_normalized({-1, -1, height});
    const Vec<3> to = structures.cage.frame().to_normalized({2, 2, height});
    const int count = meet<3>(from, (to - from).normalized(), structures.cage, quad, found);
    EXPECT_NE(count, 1) << height;
    if (count == 2) {
      ++twice;
      EXPECT_GT(height, 0.5);  // the saddle's middle
      for (const LineHit<3>& hit : found) EXPECT_NEAR(structures.cage.frame().to_caller(hit.point)[2], height, 1e-9);
    }
    never += count == 0;
  }
  EXPECT_GT(twice, 50u);
  EXPECT_GT(never, 50u);
}

}  // namespace
}  // namespace barycast
