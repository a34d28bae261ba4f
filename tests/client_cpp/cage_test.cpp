// Cages: the digest of canonical bytes, what is moved where, and refusals that name the field.

#include "barycast/client/cage.h"

#include <gtest/gtest.h>

#include <limits>

#include "shapes.h"

namespace barycast::client::testing {
namespace {

std::string refusal(CageParts parts) {
  const Result<Cage> cage = Cage::create(std::move(parts));
  return cage ? "none" : cage.error().text();
}

Faces faces(const std::vector<std::vector<uint32_t>>& lists) {
  Faces result;
  for (const auto& list : lists) result.add(list);
  return result;
}

TEST(Cage, DigestIsThatOfTheOtherPrograms) {
  // By the Python client, whose digests the daemon's tests compare with the daemon's.
  EXPECT_EQ(box().digest().hexadecimal(), "1a8631906bcefbe0352aaaeab87d8ed14e91f1810ca5e43ffdc976774b6eeb14");
  EXPECT_EQ(box().digest().size_bytes, 8u + 32 + 8 * 3 * 8 + 6 * 4 * 4);
  CageParts mixed = box_parts();
  mixed.quads.clear();
  mixed.control_vertices.insert(mixed.control_vertices.end(), {-0.0, 3.0, 0.5});
  mixed.polygons = faces({{0, 2, 3, 1}, {4, 5, 7}, {0, 1, 5, 4, 8}});
  const Result<Cage> cage = Cage::create(mixed);
  ASSERT_TRUE(cage);
  EXPECT_EQ(cage->digest().hexadecimal(), "082cf7e59f4c3d96f2a128e7df02a80b815cadbf34f36a63e6bcd7ebb5dfbeeb");
}

TEST(Cage, PolygonsOfThreeAndFourCornersAreTrianglesAndQuads) {
  CageParts parts = box_parts();
  parts.triangles = {0, 1, 2};
  parts.polygons = faces({{3, 4, 5}, {0, 1, 2, 3, 4}, {4, 5, 6, 7}});
  const Result<Cage> cage = Cage::create(parts);
  ASSERT_TRUE(cage);
  EXPECT_EQ(cage->parts().triangles, (std::vector<uint32_t>{0, 1, 2, 3, 4, 5}));
  EXPECT_EQ(cage->parts().quads.size(), 28u);
  EXPECT_EQ(cage->parts().polygons.offsets, (std::vector<uint64_t>{0, 5}));
  EXPECT_EQ(cage->parts().polygons.corners, (std::vector<uint32_t>{0, 1, 2, 3, 4}));
}

TEST(Cage, NegativeZeroHasTheDigestOfZero) {
  CageParts parts = box_parts();
  for (double& x : parts.control_vertices) x = x == 0 ? -0.0 : x;
  EXPECT_EQ(Cage::create(parts)->digest(), box().digest());
}

TEST(Cage, RefusalsNameTheField) {
  CageParts parts = box_parts();
  parts.control_vertices[4] = std::numeric_limits<double>::infinity();
  EXPECT_EQ(refusal(parts), "cage.control_vertices[1]: has a coordinate that is not finite");
  parts = box_parts();
  parts.quads[9] = 8;
  EXPECT_EQ(refusal(parts), "cage.quads[2][1]: index 8 is not in 0 ... 7");
  parts.quads.pop_back();
  EXPECT_EQ(refusal(parts), "cage.quads: must hold a multiple of 4 indices, not 23");
  parts = box_parts();
  parts.dimension = 4;
  EXPECT_TRUE(refusal(parts).starts_with("cage.control_vertices: must have 2 or 3"));
  parts = box_parts();
  parts.polygons = {.offsets = {0, 2}, .corners = {0, 1}};
  EXPECT_EQ(refusal(parts), "cage.polygons[0]: has fewer than three corners");
  parts.polygons = {.offsets = {0, 7, 3}, .corners = {0, 1, 2}};
  EXPECT_EQ(refusal(parts), "cage.polygons[1]: has fewer than three corners");
  parts.polygons = {.offsets = {0, 4}, .corners = {0, 1, 2}};
  EXPECT_TRUE(refusal(parts).starts_with("cage.polygons.offsets: must start at 0"));
  parts.polygons = {.offsets = {}, .corners = {}};
  EXPECT_TRUE(refusal(parts).starts_with("cage.polygons.offsets: must start at 0"));
  parts.polygons = {.offsets = {0, 3}, .corners = {0, 1, 99}};
  EXPECT_EQ(refusal(parts), "cage.polygons.corners[2]: index 99 is not in 0 ... 7");
}

}  // namespace
}  // namespace barycast::client::testing
