// The only door to a cage, and its name.

#include <gtest/gtest.h>

#include <limits>

#include "cage/cage.h"
#include "cage/digest.h"
#include "support/shapes.h"

namespace barycast {
namespace {

using testing::Shape;

std::string error_of(const Shape& shape) {
  if (shape.dimension == 2) {
    const auto cage = Cage<2>::create(shape.input());
    return cage.ok() ? "" : cage.error().text();
  }
  const auto cage = Cage<3>::create(shape.input());
  return cage.ok() ? "" : cage.error().text();
}

TEST(Cage, AcceptsEveryKindOfSurface) {
  for (const Shape& shape : {testing::tetrahedron(), testing::box(), testing::bent_prism(), testing::mixed_prism(),
                             testing::open_box(), testing::soup(), testing::star_polygon()})
    EXPECT_EQ(error_of(shape), "");
}

TEST(Cage, NamesTheFieldAtFault) {
  Shape shape = testing::box();
  shape.quads[4 * 3 + 2] = 57;
  EXPECT_EQ(error_of(shape), "cage.quads[3].vertex[2]: index 57 >= 8 control vertices");
  for (const double bad : {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    shape = testing::box();
    shape.vertices[3 * 5 + 1] = bad;
    EXPECT_EQ(error_of(shape), "cage.control_vertices[5]: has a coordinate that is not finite");
  }
  shape = testing::box();
  shape.vertices[0] = 1e200;
  EXPECT_EQ(error_of(shape), "cage.control_vertices[0]: has a coordinate beyond 1e100");
  shape = testing::box();
  shape.quads.clear();
  EXPECT_EQ(error_of(shape), "cage: has no elements; a cage needs segments (in the plane) or faces (in space)");
  shape.triangles = {0, 0, 1, 2, 2, 2};
  EXPECT_EQ(error_of(shape), "cage.triangles[0]: every element of the cage is degenerate (no area)");
  shape = testing::mixed_prism();
  shape.polygon_offsets = {0, 2, 10};
  EXPECT_EQ(error_of(shape), "cage.polygons[0]: has 2 corners; 3 or more are needed");
  shape.polygon_offsets = {0, 7, 5};
  EXPECT_NE(error_of(shape), "");
  shape = testing::tetrahedron();
  shape.segments = {0, 1};
  EXPECT_EQ(error_of(shape), "cage.segments: curve networks in space are not built yet; use faces");
  shape = testing::square();
  shape.triangles = {0, 1, 2};
  EXPECT_EQ(error_of(shape), "cage.triangles: a cage in the plane is made of segments");
}

TEST(Cage, RefusesVerticesThatDoNotSpanSpace) {
  EXPECT_NE(error_of(testing::box().mapped([](Eigen::VectorXd x) {
              x[2] = 3 * x[0] - x[1];
              return x;
            })),
            "");
  // An unused vertex off the plane does not help; a used one does.
  Shape flat{.vertices = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}, .triangles = {0, 1, 2}};
  EXPECT_NE(error_of(flat), "");
  flat.triangles = {0, 1, 2, 0, 1, 3};
  EXPECT_EQ(error_of(flat), "");
}

// Corners that differ in the caller's frame and coincide in the cage's: a point, not an element.
TEST(Cage, JudgesDegeneracyInItsOwnFrame) {
  const Shape plane{.dimension = 2, .vertices = {0, 0, 1e-30, 0, 1, 0, 0, 1}, .segments = {0, 1, 1, 2, 2, 3, 3, 0}};
  const auto cage = Cage<2>::create(plane.input());
  ASSERT_TRUE(cage.ok()) << cage.error().text();
  EXPECT_EQ(cage->elements().size(), 3u);
  EXPECT_EQ(cage->warnings().size(), 1u);
  const Shape specks{
      .vertices = {0, 0, 0, 1e-30, 0, 0, 0, 1e-30, 0, 1, 1, 1, 1, 1, 1 + 1e-15, 1 + 1e-15, 1, 1, 1, 0, 0, 0, 1, 0},
      .triangles = {0, 1, 2, 3, 4, 5, 0, 1, 6, 0, 2, 7}};
  EXPECT_EQ(error_of(specks), "cage.triangles[0]: every element of the cage is degenerate (no area)");
  // A small cage is not a degenerate one.
  EXPECT_EQ(error_of(testing::box().mapped([](const Eigen::VectorXd& x) { return Eigen::VectorXd(x * 1e-90); })), "");
}

TEST(Cage, ReportsWhatItIgnores) {
  Shape shape = testing::tetrahedron();
  shape.vertices.insert(shape.vertices.end(), {100, 100, 100});
  shape.triangles.insert(shape.triangles.end(), {1, 1, 2});
  const auto cage = Cage<3>::create(shape.input());
  ASSERT_TRUE(cage.ok());
  ASSERT_EQ(cage->warnings().size(), 2u);
  EXPECT_EQ(cage->warnings()[0].field, "cage.triangles[4]");
  EXPECT_EQ(cage->elements().size(), 4u);
  EXPECT_EQ(cage->used_vertices().size(), 4u);
  // The unused vertex does not stretch the frame.
  EXPECT_DOUBLE_EQ(cage->frame().diagonal, std::sqrt(3.0));
}

TEST(Cage, BasisReproducesPositionOnEveryElement) {
  const auto cage = Cage<3>::create(testing::mixed_prism().input());
  ASSERT_TRUE(cage.ok());
  EXPECT_EQ(cage->elements().size(), 4u + 3u + 2u * 5u);  // triangles, quads, fans
  for (const Element& element : cage->elements()) {
    const std::vector<double> shares =
        element.corner_count() == 3 ? std::vector{0.2, 0.5, 0.3} : std::vector{0.1, 0.4, 0.2, 0.3};
    Vec<3> point = Vec<3>::Zero(), by_basis = Vec<3>::Zero();
    for (int i = 0; i < element.corner_count(); ++i) point += shares[static_cast<size_t>(i)] * cage->corner(element, i);
    std::vector<VertexWeight> basis;
    cage->append_basis(element, shares, 1.0, basis);
    double sum = 0.0;
    for (const VertexWeight& phi : basis) {
      by_basis += phi.weight * cage->control_vertices()[phi.vertex];
      sum += phi.weight;
    }
    EXPECT_NEAR(sum, 1.0, 1e-15);
    EXPECT_LT((by_basis - point).norm(), 1e-15);
  }
}

TEST(Cage, PowersOfTwoScaleWithoutRounding) {
  const auto cage = Cage<3>::create(testing::bent_prism().input());
  const auto scaled = Cage<3>::create(
      testing::bent_prism().mapped([](const Eigen::VectorXd& x) { return Eigen::VectorXd(x * 1024.0); }).input());
  ASSERT_TRUE(cage.ok() && scaled.ok());
  EXPECT_EQ(scaled->frame().diagonal, 1024.0 * cage->frame().diagonal);
  for (size_t v = 0; v < 16; ++v) EXPECT_EQ(scaled->control_vertices()[v], cage->control_vertices()[v]);
}

TEST(Digest, IsShaOfTheCanonicalBytes) {
  // From Python: hashlib.sha256 over struct.pack of the fields that cage.proto lists.
  const Shape shape = testing::tetrahedron();
  EXPECT_EQ(digest(shape.input()).size_bytes, 8u + 32u + 12u * 8u + 12u * 4u);
  EXPECT_EQ(hexadecimal(digest(shape.input())), "32acbe8e3bf9b54a4abc45781903833f22cbdcbbfc7c52323a040204fd686ce9");
  Shape negative_zero = shape;
  negative_zero.vertices[0] = -0.0;
  EXPECT_EQ(digest(negative_zero.input()), digest(shape.input()));
  Shape other = shape;
  std::swap(other.triangles[0], other.triangles[1]);
  EXPECT_NE(digest(other.input()), digest(shape.input()));
}

}  // namespace
}  // namespace barycast
