// Mean value coordinates in closed form: against quadrature, on the way to the cage and in the planes of its faces,
// their gradients, what they refuse.

#include "solve/exact_mean_value.h"

#include <gtest/gtest.h>

#include <limits>

#include "query/element_distance.h"
#include "support/mean_value.h"
#include "support/mean_value_quadrature.h"
#include "support/rows.h"

namespace barycast {
namespace {

using testing::MeanValueQuadrature;
using testing::Shape;

Cage<3> cage_of(const Shape& shape) {
  auto cage = Cage<3>::create(shape.input());
  EXPECT_TRUE(cage.ok());
  return std::move(cage).value();
}

std::vector<Shape> triangle_shapes() {
  return {testing::tetrahedron(), testing::triangulated(testing::box()), testing::triangulated(testing::bent_prism()),
          testing::triangulated(testing::mixed_prism()), testing::triangulated(testing::sphere(5, 1.0))};
}

// A cage with its closed form.
struct Solved {
  explicit Solved(const Shape& shape) : cage(cage_of(shape)) {
    auto created = ExactMeanValue::create(cage);
    EXPECT_TRUE(created.ok()) << (created.ok() ? "" : created.error().text());
    solution = std::move(created).value();
  }
  SolvedRows<3> at(const std::vector<Vec<3>>& points, bool gradients = false) const {
    SolvedRows<3> rows;
    solution->evaluate(points, gradients, rows);
    return rows;
  }
  Eigen::VectorXd at(const Vec<3>& x) const { return at(std::vector{x}).values.row(0); }

  Cage<3> cage;
  std::unique_ptr<const ExactMeanValue> solution;
};

std::vector<Vec<3>> points_in(size_t count, double reach, uint32_t seed) {
  const auto numbers = testing::random_points(count, 3, -reach, reach, seed);
  std::vector<Vec<3>> points(count);
  for (size_t i = 0; i < count; ++i) points[i] = Eigen::Map<const Vec<3>>(numbers.data() + 3 * i);
  return points;
}

Eigen::VectorXd vector_of(const std::vector<double>& values) {
  return Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
}

// The basis at a point of an element.
Eigen::VectorXd basis_of(const Cage<3>& cage, const Element& element, const std::array<double, 3>& shares) {
  std::vector<VertexWeight> basis;
  cage.append_basis(element, shares, 1.0, basis);
  Eigen::VectorXd result = Eigen::VectorXd::Zero(cage.control_vertex_count());
  for (const auto& [vertex, share] : basis) result[static_cast<Eigen::Index>(vertex)] += share;
  return result;
}

Vec<3> point_of(const Cage<3>& cage, const Element& element, const std::array<double, 3>& shares) {
  return shares[0] * cage.corner(element, 0) + shares[1] * cage.corner(element, 1) +
         shares[2] * cage.corner(element, 2);
}

double distance_to(const Cage<3>& cage, const Vec<3>& x) {
  double least = std::numeric_limits<double>::infinity();
  for (const Element& e : cage.elements())
    least = std::min(least,
                     closest_on_triangle(x, cage.corner(e, 0), cage.corner(e, 1), cage.corner(e, 2)).distance_squared);
  return std::sqrt(least);
}

TEST(ExactMeanValue, IsTheQuadrature) {
  for (const Shape& shape : triangle_shapes()) {
    const Solved solved(shape);
    const MeanValueQuadrature reference(solved.cage);
    for (const double reach : {0.3, 1.0, 3.0, 30.0})
      for (const Vec<3>& x : points_in(12, reach, 7))
        EXPECT_LT((solved.at(x) - vector_of(reference(x))).cwiseAbs().maxCoeff(), 1e-11 * std::max(1.0, x.norm()))
            << x.transpose();
  }
}

TEST(ExactMeanValue, IsTheFormulaOfJu) {
  for (const Shape& shape : {testing::triangulated(testing::bent_prism()), testing::triangulated(testing::box())}) {
    const Solved solved(shape);
    for (const Vec<3>& x : points_in(100, 0.6, 3)) {
      const auto reference = testing::mesh_mean_value(shape, solved.cage.frame().to_caller(x));
      EXPECT_LT((solved.at(x) - vector_of(reference)).cwiseAbs().maxCoeff(), 1e-8);
    }
  }
}

TEST(ExactMeanValue, ReproducesPositionToRounding) {
  for (const Shape& shape : triangle_shapes()) {
    const Solved solved(shape);
    for (const double reach : {0.3, 0.6, 2.0, 6.0, 100.0})
      for (const Vec<3>& x : points_in(100, reach, 5)) {
        const Eigen::VectorXd row = solved.at(x);
        Vec<3> position = Vec<3>::Zero();
        for (Eigen::Index v = 0; v < row.size(); ++v)
          position += row[v] * solved.cage.control_vertices()[static_cast<size_t>(v)];
        EXPECT_LT((position - x).norm(), 1e-12 * std::max(1.0, x.norm())) << x.transpose();
        EXPECT_NEAR(row.sum(), 1.0, 1e-12 * std::max(1.0, x.norm()));
      }
  }
}

// Towards faces, edges and vertices, from both sides: the distance to the basis shrinks with that to the cage, with a
// logarithm at edges and vertices.
TEST(ExactMeanValue, TendsToTheBasis) {
  for (const Shape& shape : triangle_shapes()) {
    const Solved solved(shape);
    for (const Element& element : solved.cage.elements())
      for (const std::array<double, 3>& shares : {std::array{0.3, 0.5, 0.2}, {0.4, 0.6, 0.0}, {0.0, 1.0, 0.0}}) {
        const Vec<3> y = point_of(solved.cage, element, shares), direction = Vec<3>(0.31, -0.53, 0.79).normalized();
        const Eigen::VectorXd basis = basis_of(solved.cage, element, shares);
        for (double distance = 1e-2; distance > 1e-13; distance /= 10)
          for (const double side : {1.0, -1.0}) {
            const Eigen::VectorXd row = solved.at(Vec<3>(y + side * distance * direction));
            EXPECT_LT((row - basis).cwiseAbs().maxCoeff(), 40 * distance * (1 - std::log(distance)) + 1e-13)
                << distance;
          }
        const auto on = solved.at(std::vector{y}, true);
        EXPECT_EQ(on.on_cage[0], 1);
        EXPECT_LT((Eigen::VectorXd(on.values.row(0)) - basis).cwiseAbs().maxCoeff(), 1e-13);
        for (const auto& partial : on.gradients) {
          EXPECT_TRUE(partial.allFinite());
          EXPECT_LT(partial.cwiseAbs().maxCoeff(), 1e3);
        }
      }
  }
}

// Where the closed form divides by the height over a face: in its plane, outside of it.
TEST(ExactMeanValue, CrossesThePlanesOfFacesSmoothly) {
  for (const Shape& shape : triangle_shapes()) {
    const Solved solved(shape);
    const MeanValueQuadrature reference(solved.cage);
    const auto elements = solved.cage.elements();
    for (size_t i = 0; i < elements.size(); i += 1 + elements.size() / 8)
      for (const std::array<double, 3>& shares :
           {std::array{1.7, -0.4, -0.3}, {0.6, 0.8, -0.4}, {2.0, -1.0, 0.0}, {0.0, -0.8, 1.8}}) {
        const Vec<3> y = point_of(solved.cage, elements[i], shares);
        const Vec<3> normal = element_normal(solved.cage, elements[i], {0.3, 0.3, 0.4, 0.0});
        if (solved.at(std::vector{y}).on_cage[0] != 0) continue;  // it may lie on another face
        for (const double offset : {0.0, 1e-17, 1e-15, -1e-14, 1e-12, -1e-9, 1e-6, 1e-4, -1e-3, 3e-3, 1e-2}) {
          const Vec<3> x = y + offset * normal;
          EXPECT_LT((solved.at(x) - vector_of(reference(x))).cwiseAbs().maxCoeff(), 1e-11) << offset << " " << i;
        }
      }
  }
}

TEST(ExactMeanValue, HasTheGradientsOfItsValues) {
  for (const Shape& shape : triangle_shapes()) {
    const Solved solved(shape);
    for (const double reach : {0.4, 1.5, 12.0}) {
      const auto points = points_in(40, reach, 9);
      const SolvedRows<3> rows = solved.at(points, true);
      EXPECT_EQ(rows.values, solved.at(points).values);
      const double step = 1e-3 * std::max(1.0, reach);  // of fourth order: rounding and the next order balance
      for (size_t i = 0; i < points.size(); ++i) {
        if (distance_to(solved.cage, points[i]) < 0.05) continue;  // too steep for the step
        for (int k = 0; k < 3; ++k) {
          const auto along = [&](double s) { return solved.at(Vec<3>(points[i] + s * step * Vec<3>::Unit(k))); };
          const Eigen::VectorXd slope = (8 * (along(1) - along(-1)) - (along(2) - along(-2))) / (12 * step);
          const Eigen::VectorXd gradient = rows.gradients[static_cast<size_t>(k)].row(static_cast<Eigen::Index>(i));
          EXPECT_LT((gradient - slope).cwiseAbs().maxCoeff(), 1e-6 * std::max(1.0, slope.norm()))
              << points[i].transpose();
        }
      }
    }
  }
}

// Gradients close to the cage: the field is differentiable across faces.
TEST(ExactMeanValue, HasGradientsThatMeetAtFaces) {
  const Solved solved(testing::triangulated(testing::bent_prism()));
  for (const Element& element : solved.cage.elements()) {
    const std::array<double, 3> shares = {0.3, 0.5, 0.2};
    const Vec<3> y = point_of(solved.cage, element, shares);
    const Vec<3> normal = element_normal(solved.cage, element, {0.3, 0.5, 0.2, 0.0});
    const auto rows = solved.at({y, y + 1e-6 * normal, y - 1e-6 * normal}, true);
    for (const auto& partial : rows.gradients) {
      EXPECT_LT((partial.row(0) - partial.row(1)).cwiseAbs().maxCoeff(), 1e-3);
      EXPECT_LT((partial.row(0) - partial.row(2)).cwiseAbs().maxCoeff(), 1e-3);
    }
  }
}

TEST(ExactMeanValue, IsTheSameBitsInAnyCompany) {
  const Solved solved(testing::triangulated(testing::bent_prism()));
  auto points = points_in(101, 0.7, 4);
  points[7] = solved.cage.control_vertices()[3];
  points[20] *= 100.0;
  points[33] = point_of(solved.cage, solved.cage.elements()[5], {1.7, -0.4, -0.3});
  const SolvedRows<3> rows = solved.at(points, true);
  for (size_t i = 0; i < points.size(); ++i) {
    const SolvedRows<3> alone = solved.at(std::vector{points[i]}, true);
    const auto row = static_cast<Eigen::Index>(i);
    EXPECT_EQ(alone.values.row(0), rows.values.row(row));
    EXPECT_EQ(alone.on_cage[0], rows.on_cage[i]);
    for (size_t k = 0; k < 3; ++k) EXPECT_EQ(alone.gradients[k].row(0), rows.gradients[k].row(row));
  }
}

TEST(ExactMeanValue, IsSensibleFarAway) {
  const Solved solved(testing::triangulated(testing::bent_prism()));
  for (const double far : {3.999999, 4.000001, 1e2, 1e4, 1e6, 1e9}) {
    const Vec<3> x = far * Vec<3>(0.6, -0.48, 0.64);
    const auto rows = solved.at(std::vector{x}, true);
    EXPECT_TRUE(rows.values.allFinite() && rows.gradients[0].allFinite());
    // Coordinates grow linearly; neighbours agree but for rounding.
    const Eigen::VectorXd here = rows.values.row(0), there = solved.at(Vec<3>(x * (1 + 1e-9)));
    EXPECT_LT((here - there).norm(), (1e-8 + 1e-14 * far) * here.norm()) << far;
  }
}

// Weights of the node at a polygon's mean go to its corners: a row has a column per control vertex, and no more.
TEST(ExactMeanValue, SpreadsPolygonCentresOverTheirCorners) {
  const Shape shape = testing::triangulated(testing::mixed_prism());
  ASSERT_FALSE(shape.polygon_corners.empty());
  const Solved solved(shape);
  const Eigen::VectorXd row = solved.at(Vec<3>(0.05, -0.02, 0.1));
  EXPECT_EQ(row.size(), static_cast<Eigen::Index>(shape.vertex_count()));
  EXPECT_GT(row.minCoeff(), 0.0);  // inside of a convex cage, but for its slight twist
}

TEST(ExactMeanValue, RefusesWhatHasNoClosedForm) {
  for (const Shape& shape :
       {testing::box(), testing::mixed_prism(), testing::triangulated(testing::open_box()), testing::soup()}) {
    const Cage<3> cage = cage_of(shape);
    const auto refused = ExactMeanValue::create(cage);
    ASSERT_FALSE(refused.ok());
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalidArgument);
    EXPECT_EQ(refused.error().field, "estimator");
    EXPECT_NE(refused.error().message.find(shape.quads.empty() ? "closed cages" : "bilinear"), std::string::npos);
  }
}

// On bilinear quads only rays know the answer: 20000 of them, to some 1e-3.
TEST(MeanValueQuadratureTest, AgreesWithRaysOnQuads) {
  const Shape shape = testing::bent_prism();
  const auto index = testing::make_index(shape);
  const Cage<3> cage = cage_of(shape);
  const MeanValueQuadrature reference(cage);
  Options options;
  options.coordinates = CoordinateKind::kMeanValue;
  options.samples = 20000;
  options.prune_below = 0.0;
  std::vector<double> points;
  for (const Vec<3>& x : {Vec<3>(0.5, 0.6, 0.5), Vec<3>(1.4, 0.5, 0.4), Vec<3>(0.6, 1.4, 0.7), Vec<3>(3, 2, 1)})
    points.insert(points.end(), x.begin(), x.end());
  const RowBlock rows = testing::bind_or_die(index, testing::loose_points(points), options);
  for (size_t i = 0; i < rows.row_count(); ++i) {
    const auto row = testing::dense_row(rows, i, shape.vertex_count());
    const Vec<3> x = cage.frame().to_normalized(Eigen::Map<const Vec<3>>(points.data() + 3 * i));
    EXPECT_LT((vector_of(row) - vector_of(reference(x))).cwiseAbs().maxCoeff(), 3e-3) << i;
  }
}

TEST(MeanValueQuadratureTest, IsTheClosedFormNearTheCage) {
  for (const double off : {1e-2, 1e-4, 1e-6}) {
    const Cage<3> cage = cage_of(testing::triangulated(testing::bent_prism()));
    const Element& element = cage.elements()[3];
    const Vec<3> x =
        point_of(cage, element, {0.3, 0.5, 0.2}) + off * element_normal(cage, element, {0.3, 0.5, 0.2, 0.0});
    const auto row = MeanValueQuadrature(cage)(x);
    const auto exact = ExactMeanValue::create(cage);
    SolvedRows<3> rows;
    (*exact)->evaluate(std::vector{x}, false, rows);
    EXPECT_LT((vector_of(row) - Eigen::VectorXd(rows.values.row(0))).cwiseAbs().maxCoeff(), 1e-11) << off;
  }
}

}  // namespace
}  // namespace barycast
