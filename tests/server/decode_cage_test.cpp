// Cages: what decode refuses by itself, and the paths of what Cage::create refuses after it.

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "decode.h"
#include "messages.h"

namespace barycast::server {
namespace {

using namespace testing;

constexpr ErrorCode kInvalid = ErrorCode::kInvalidArgument;

// Decode, then create, as the server does.
Status accept(const v1::Cage& cage, const Limits& limits = {}) {
  const Result<CageStorage> storage = decode_cage(cage, limits);
  if (!storage) return storage.error();
  if (storage->dimension == 2) {
    const Result<Cage<2>> created = Cage<2>::create(storage->input());
    return created.ok() ? Status(Done{}) : Status(created.error());
  }
  const Result<Cage<3>> created = Cage<3>::create(storage->input());
  return created.ok() ? Status(Done{}) : Status(created.error());
}

void expect_refused(v1::Cage cage, ErrorCode code, const std::string& field,
                    const std::function<void(v1::Cage&)>& spoil) {
  spoil(cage);
  const Status status = accept(cage);
  ASSERT_FALSE(status.ok()) << field;
  EXPECT_EQ(status.error().code, code) << status.error().text();
  EXPECT_EQ(status.error().field, field) << status.error().text();
}

TEST(DecodeCage, AcceptsSoundOnes) {
  EXPECT_TRUE(accept(tetrahedron()).ok());
  EXPECT_TRUE(accept(square()).ok());
  v1::Cage polygons = tetrahedron();
  polygons.clear_triangles();
  *polygons.mutable_polygons()->mutable_offsets() = indices(1, {0, 3, 6, 9, 12});
  *polygons.mutable_polygons()->mutable_corners() = indices(1, {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3});
  EXPECT_TRUE(accept(polygons).ok());
}

TEST(DecodeCage, WidensFloat32) {
  v1::Cage cage = tetrahedron();
  *cage.mutable_control_vertices() = floats(3, {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1});
  const Result<CageStorage> storage = decode_cage(cage, {});
  ASSERT_TRUE(storage.ok());
  EXPECT_EQ(digest(storage->input()), digest(decode_cage(tetrahedron(), {})->input()));
}

TEST(DecodeCage, OneDigestForNoPolygons) {
  v1::Cage cage = tetrahedron();
  *cage.mutable_polygons()->mutable_offsets() = indices(1, {0});
  ASSERT_TRUE(accept(cage).ok());
  EXPECT_EQ(digest(decode_cage(cage, {})->input()), digest(decode_cage(tetrahedron(), {})->input()));
}

TEST(DecodeCage, RefusesControlVertices) {
  expect_refused({}, kInvalid, "cage.control_vertices", [](v1::Cage&) {});
  const v1::Cage sound = tetrahedron();
  const auto vertices = [](v1::Cage& c) -> v1::Array& { return *c.mutable_control_vertices(); };
  expect_refused(sound, kInvalid, "cage.control_vertices.columns", [&](v1::Cage& c) { vertices(c).set_columns(4); });
  expect_refused(sound, kInvalid, "cage.control_vertices.type", [&](v1::Cage& c) { vertices(c).clear_type(); });
  expect_refused(sound, kInvalid, "cage.control_vertices.type",
                 [&](v1::Cage& c) { vertices(c).set_type(v1::DATA_TYPE_UINT32); });
  expect_refused(sound, kInvalid, "cage.control_vertices.type",
                 [&](v1::Cage& c) { vertices(c).set_type(static_cast<v1::DataType>(42)); });
  expect_refused(sound, kInvalid, "cage.control_vertices.data",
                 [&](v1::Cage& c) { vertices(c).mutable_data()->pop_back(); });
  expect_refused(sound, kInvalid, "cage.control_vertices.data", [&](v1::Cage& c) { vertices(c).set_rows(5); });
  expect_refused(sound, kInvalid, "cage.control_vertices.data", [&](v1::Cage& c) { vertices(c).set_rows(0); });
  // rows x columns x bytes that wraps around 64 bits.
  expect_refused(sound, kInvalid, "cage.control_vertices.rows",
                 [&](v1::Cage& c) { vertices(c).set_rows(std::numeric_limits<uint64_t>::max() / 3); });
  for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    expect_refused(sound, kInvalid, "cage.control_vertices[2]", [&](v1::Cage& c) {
      vertices(c) = doubles(3, {0, 0, 0, 1, 0, 0, 0, bad, 0, 0, 0, 1});
    });
  }
  expect_refused(sound, kInvalid, "cage.control_vertices", [&](v1::Cage& c) {
    vertices(c) = doubles(3, {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0});
  });
}

TEST(DecodeCage, RefusesElements) {
  const v1::Cage sound = tetrahedron();
  expect_refused(sound, kInvalid, "cage", [](v1::Cage& c) { c.clear_triangles(); });
  expect_refused(sound, kInvalid, "cage.triangles.columns", [](v1::Cage& c) { c.mutable_triangles()->set_columns(4); });
  expect_refused(sound, kInvalid, "cage.triangles.type",
                 [](v1::Cage& c) { c.mutable_triangles()->set_type(v1::DATA_TYPE_FLOAT32); });
  expect_refused(sound, kInvalid, "cage.triangles.data",
                 [](v1::Cage& c) { c.mutable_triangles()->mutable_data()->resize(40); });
  expect_refused(sound, kInvalid, "cage.triangles[1].vertex[2]", [](v1::Cage& c) {
    *c.mutable_triangles() = indices(3, {0, 2, 1, 0, 1, 4});
  });
  expect_refused(sound, kInvalid, "cage.quads[0].vertex[3]", [](v1::Cage& c) {
    *c.mutable_quads() = indices(4, {0, 1, 2, 4000000000u});
  });
  expect_refused(sound, kInvalid, "cage.triangles[0]", [](v1::Cage& c) {
    *c.mutable_triangles() = indices(3, {0, 0, 1, 2, 2, 2});
  });
}

TEST(DecodeCage, RefusesPolygons) {
  const v1::Cage sound = tetrahedron();
  const auto set = [](std::vector<uint32_t> offsets, std::vector<uint32_t> corners) {
    return [=](v1::Cage& c) {
      *c.mutable_polygons()->mutable_offsets() = indices(1, offsets);
      *c.mutable_polygons()->mutable_corners() = indices(1, corners);
    };
  };
  expect_refused(sound, kInvalid, "cage.polygons.offsets", set({}, {0, 1, 2}));
  expect_refused(sound, kInvalid, "cage.polygons.offsets[0]", set({1, 3}, {0, 1, 2}));
  expect_refused(sound, kInvalid, "cage.polygons[0]", set({0, 2}, {0, 1}));
  expect_refused(sound, kInvalid, "cage.polygons[1]", set({0, 6, 3}, {0, 1, 2, 0, 1, 2}));
  expect_refused(sound, kInvalid, "cage.polygons.offsets[1]", set({0, 3}, {0, 1, 2, 3}));
  expect_refused(sound, kInvalid, "cage.polygons.offsets[1]", set({0, 4000000000u}, {0, 1, 2, 3}));
  expect_refused(sound, kInvalid, "cage.polygons[0].vertex[2]", set({0, 3}, {0, 1, 9}));
}

TEST(DecodeCage, RefusesWhatIsNotBuiltOrDoesNotBelong) {
  constexpr ErrorCode kUnimplemented = ErrorCode::kUnimplemented;
  expect_refused(tetrahedron(), kUnimplemented, "cage.points",
                 [](v1::Cage& c) { *c.mutable_points() = indices(1, {0}); });
  expect_refused(tetrahedron(), kUnimplemented, "cage.segments", [](v1::Cage& c) {
    *c.mutable_segments() = indices(2, {0, 1});
  });
  expect_refused(tetrahedron(), kUnimplemented, "cage.stencils", [](v1::Cage& c) {
    *c.mutable_stencils()->mutable_offsets() = indices(1, {0, 1});
  });
  expect_refused(square(), kUnimplemented, "cage.points", [](v1::Cage& c) { *c.mutable_points() = indices(1, {0}); });
  expect_refused(square(), kInvalid, "cage.triangles", [](v1::Cage& c) {
    *c.mutable_triangles() = indices(3, {0, 1, 2});
  });
  expect_refused(square(), kInvalid, "cage.quads", [](v1::Cage& c) { *c.mutable_quads() = indices(4, {0, 1, 2, 3}); });
  expect_refused(square(), kInvalid, "cage.polygons", [](v1::Cage& c) {
    *c.mutable_polygons()->mutable_corners() = indices(1, {0, 1, 2});
  });
}

TEST(DecodeCage, RefusesByCanonicalSize) {
  const uint64_t size = canonical_size_bytes(decode_cage(tetrahedron(), {})->input());
  EXPECT_TRUE(accept(tetrahedron(), {.cage_bytes_max = size}).ok());
  const Status status = accept(tetrahedron(), {.cage_bytes_max = size - 1});
  ASSERT_FALSE(status.ok());
  EXPECT_EQ(status.error().code, ErrorCode::kResourceExhausted);
  EXPECT_EQ(status.error().field, "cage");
}

TEST(DecodeCage, RefusesBytesThatAreNoCage) {
  const Result<CageStorage> storage = decode_cage_bytes("\xff\xff\xff no cage", {});
  ASSERT_FALSE(storage.ok());
  EXPECT_EQ(storage.error().code, kInvalid);
  EXPECT_EQ(storage.error().field, "cage");
  EXPECT_TRUE(decode_cage_bytes(tetrahedron().SerializeAsString(), {}).ok());
}

}  // namespace
}  // namespace barycast::server
