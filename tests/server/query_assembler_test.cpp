// Blocks of points and faces against what the header announced.

#include "query_assembler.h"

#include <gtest/gtest.h>

#include <cmath>

#include "messages.h"

namespace barycast::server {
namespace {

using namespace testing;

void expect_refused(const Status& status, const std::string& field) {
  ASSERT_FALSE(status.ok()) << field;
  EXPECT_EQ(status.error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(status.error().field, field) << status.error().text();
}

TEST(QueryAssembler, JoinsBlocks) {
  QueryAssembler assembler({.points = 4, .faces = 2, .corners = 7}, 3);
  ASSERT_TRUE(assembler.add(points({0, 0, 0, 1, 1, 1}).points()).ok());
  ASSERT_TRUE(assembler.add(faces({3}, {0, 1, 2}).faces()).ok());
  v1::PointBlock block;
  *block.mutable_points() = floats(3, {2, 2, 2, 3, 3, 3.5f});
  ASSERT_TRUE(assembler.add(block).ok());
  ASSERT_TRUE(assembler.add(faces({4}, {0, 1, 2, 3}).faces()).ok());
  const Result<QueryInput> queries = assembler.take();
  ASSERT_TRUE(queries.ok());
  EXPECT_EQ(queries->points, (std::vector<double>{0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3.5}));
  EXPECT_EQ(queries->face_offsets, (std::vector<uint32_t>{0, 3, 7}));
  EXPECT_EQ(queries->face_corners, (std::vector<uint32_t>{0, 1, 2, 0, 1, 2, 3}));
}

TEST(QueryAssembler, RefusesPoints) {
  QueryAssembler assembler({.points = 2}, 3);
  expect_refused(assembler.add(points({1, 2, 3, 4, 5, 6, 7, 8, 9}).points()), "points.points.rows");
  expect_refused(assembler.add(points({1, 2}, 2).points()), "points.points.columns");
  v1::PointBlock truncated = points({1, 2, 3, 4, 5, 6}).points();
  truncated.mutable_points()->mutable_data()->resize(40);
  const Status status = assembler.add(truncated);
  expect_refused(status, "points.points.data");
  EXPECT_NE(status.error().text().find("points.points.data: 40 bytes, expected 48"), std::string::npos)
      << status.error().text();
  v1::PointBlock lying = points({1, 2, 3}).points();
  lying.mutable_points()->set_rows(~uint64_t{0});
  expect_refused(assembler.add(lying), "points.points.rows");
}

TEST(QueryAssembler, RefusesPointsThatAreNotFinite) {
  QueryAssembler assembler({.points = 3}, 3);
  ASSERT_TRUE(assembler.add(points({1, 2, 3}).points()).ok());
  expect_refused(assembler.add(points({1, 2, 3, 4, std::nan(""), 6}).points()), "points[2]");
}

TEST(QueryAssembler, RefusesFaces) {
  const QueryCounts counts{.points = 4, .faces = 2, .corners = 7};
  expect_refused(QueryAssembler(counts, 3).add(faces({3, 3, 3}, {0, 1, 2, 0, 1, 2, 0, 1, 2}).faces()),
                 "faces.corner_counts.rows");
  expect_refused(QueryAssembler(counts, 3).add(faces({4, 4}, {0, 1, 2, 3, 0, 1, 2, 3}).faces()), "faces.corners.rows");
  expect_refused(QueryAssembler(counts, 3).add(faces({2}, {0, 1}).faces()), "faces[0]");
  expect_refused(QueryAssembler(counts, 3).add(faces({3, 4}, {0, 1, 2, 0, 1, 2, 4}).faces()), "faces[1].corner[3]");
  expect_refused(QueryAssembler(counts, 3).add(faces({3}, {0, 1}).faces()), "faces.corners.rows");
  expect_refused(QueryAssembler(counts, 3).add(faces({3}, {0, 1, 2, 3}).faces()), "faces.corners.rows");
  expect_refused(QueryAssembler(counts, 3).add(faces({4294967295u}, {0, 1, 2}).faces()), "faces.corners.rows");
  v1::FaceBlock floats_for_indices;
  *floats_for_indices.mutable_corner_counts() = floats(1, {3});
  expect_refused(QueryAssembler(counts, 3).add(floats_for_indices), "faces.corner_counts.type");
}

TEST(QueryAssembler, RefusesTooLittle) {
  QueryAssembler assembler({.points = 3, .faces = 1, .corners = 3}, 3);
  expect_refused(assembler.take().ok() ? Status(Done{}) : Status(QueryAssembler({.points = 3}, 3).take().error()),
                 "points");
  ASSERT_TRUE(assembler.add(points({0, 0, 0, 1, 1, 1, 2, 2, 2}).points()).ok());
  const Result<QueryInput> no_faces = assembler.take();
  ASSERT_FALSE(no_faces.ok());
  EXPECT_EQ(no_faces.error().field, "faces");
  QueryAssembler few_corners({.points = 3, .faces = 1, .corners = 4}, 3);
  ASSERT_TRUE(few_corners.add(points({0, 0, 0, 1, 1, 1, 2, 2, 2}).points()).ok());
  ASSERT_TRUE(few_corners.add(faces({3}, {0, 1, 2}).faces()).ok());
  EXPECT_EQ(few_corners.take().error().field, "faces.corners");
}

// A client that announces much and sends little must not cost memory: this would need 2.4 GB.
TEST(QueryAssembler, ReservesNothingForWhatWasAnnounced) {
  QueryAssembler assembler({.points = 100'000'000}, 3);
  ASSERT_TRUE(assembler.add(points({1, 2, 3}).points()).ok());
  EXPECT_FALSE(assembler.take().ok());
}

}  // namespace
}  // namespace barycast::server
