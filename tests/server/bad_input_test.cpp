// Every bad input through the real server: the code, the field's path, nothing computed, and a server
// that goes on.

#include <cmath>

#include "fixture.h"

namespace barycast::server {
namespace {

using namespace testing;
using Requests = std::vector<v1::ComputeCoordinatesRequest>;

class BadInput : public ServerTest {
 protected:
  void SetUp() override {
    DaemonSettings settings;
    settings.limits = {.cage_bytes_max = 2000,
                       .points_max = 1000,
                       .faces_max = 100,
                       .samples_max = 1000,
                       .block_rows_max = 100,
                       .message_bytes_max = 100'000,
                       .digests_max = 2,
                       .request_bytes_max = 16 << 20};
    start(settings);
  }

  void expect_refused(const Requests& requests, int code, const std::string& field, const CallSettings& settings = {}) {
    const Answer answer = client_->compute(requests, settings);
    EXPECT_EQ(answer.code, code) << field << ": " << answer.message;
    EXPECT_EQ(answer.field(), field) << answer.message;
    EXPECT_FALSE(answer.message.empty());
    EXPECT_FALSE(answer.header.has_value());
    EXPECT_EQ(counters().steps, 0u) << field;
  }
};

const std::vector<double> kPoint = {0.1, 0.2, 0.3};

Requests with_cage(const v1::Cage& cage) {
  return {header(1, cage), points(kPoint)};
}

TEST_F(BadInput, Cages) {
  expect_refused(with_cage({}), kInvalidArgument, "cage.control_vertices");
  v1::Cage cage = tetrahedron();
  cage.clear_triangles();
  expect_refused(with_cage(cage), kInvalidArgument, "cage");
  cage = tetrahedron();
  *cage.mutable_triangles() = indices(3, {0, 1, 2, 0, 1, 57});
  expect_refused(with_cage(cage), kInvalidArgument, "cage.triangles[1].vertex[2]");
  *cage.mutable_triangles() = indices(3, {0, 0, 0, 1, 1, 2});
  expect_refused(with_cage(cage), kInvalidArgument, "cage.triangles[0]");
  cage = tetrahedron();
  *cage.mutable_control_vertices() = doubles(3, {0, 0, 0, 1, 0, 0, 0, std::nan(""), 0, 0, 0, 1});
  expect_refused(with_cage(cage), kInvalidArgument, "cage.control_vertices[2]");
  *cage.mutable_control_vertices() = doubles(3, {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0});
  expect_refused(with_cage(cage), kInvalidArgument, "cage.control_vertices");
  cage = tetrahedron();
  cage.mutable_triangles()->mutable_data()->resize(47);
  expect_refused(with_cage(cage), kInvalidArgument, "cage.triangles.data");
  cage = tetrahedron();
  *cage.mutable_points() = indices(1, {0});
  expect_refused(with_cage(cage), kUnimplemented, "cage.points");
  cage = tetrahedron();
  *cage.mutable_segments() = indices(2, {0, 1});
  expect_refused(with_cage(cage), kUnimplemented, "cage.segments");
  cage = tetrahedron();
  *cage.mutable_triangles() = indices(3, std::vector<uint32_t>(3 * 200, 1));
  expect_refused(with_cage(cage), kResourceExhausted, "cage");
  cage = square();
  *cage.mutable_quads() = indices(4, {0, 1, 2, 3});
  expect_refused(with_cage(cage), kInvalidArgument, "cage.quads");
  expect_works();
}

TEST_F(BadInput, Headers) {
  const auto spoilt = [](auto spoil) {
    auto head = header(1);
    spoil(*head.mutable_header());
    return Requests{head, points(kPoint)};
  };
  using Header = v1::ComputeHeader;
  expect_refused(spoilt([](Header& h) { h.mutable_queries()->set_point_count(0); }), kInvalidArgument,
                 "header.queries.point_count");
  expect_refused(spoilt([](Header& h) { h.mutable_queries()->set_point_count(1001); }), kInvalidArgument,
                 "header.queries.point_count");
  expect_refused(spoilt([](Header& h) { h.mutable_options()->set_samples(0); }), kInvalidArgument,
                 "header.options.samples");
  expect_refused(spoilt([](Header& h) { h.mutable_options()->set_samples(4'000'000'000u); }), kInvalidArgument,
                 "header.options.samples");
  expect_refused(spoilt([](Header& h) { h.mutable_options()->set_preset(static_cast<v1::Preset>(12)); }),
                 kInvalidArgument, "header.options.preset");
  expect_refused(spoilt([](Header& h) { h.mutable_options()->set_denoise(v1::DENOISE_MESH); }), kInvalidArgument,
                 "header.options.denoise");
  expect_refused(spoilt([](Header& h) { h.mutable_options()->set_coordinates(static_cast<v1::CoordinateKind>(9)); }),
                 kInvalidArgument, "header.options.coordinates");
  expect_refused(spoilt([](Header& h) { h.mutable_output()->set_influences_max(3); }), kInvalidArgument,
                 "header.output.influences_max");
  expect_refused(spoilt([](Header& h) { h.mutable_output()->set_block_rows(101); }), kInvalidArgument,
                 "header.output.block_rows");
  expect_refused(spoilt([](Header& h) { h.clear_cage(); }), kInvalidArgument, "header");
  expect_refused(spoilt([](Header& h) {
                   h.mutable_expected_digest()->set_sha256(std::string(32, '\1'));
                   h.mutable_expected_digest()->set_size_bytes(184);
                 }),
                 kInvalidArgument, "header.expected_digest");
  expect_refused(spoilt([](Header& h) {
                   h.mutable_resume()->set_first_row(1);
                   h.mutable_resume()->set_numerics_version(1);
                 }),
                 kInvalidArgument, "header.resume.first_row");
  expect_refused(spoilt([](Header& h) { h.mutable_resume()->set_numerics_version(999); }), kFailedPrecondition,
                 "header.resume.numerics_version");
  expect_refused(spoilt([](Header&) {}), kInvalidArgument, "metadata.x-cage-digest",
                 {.metadata = {{"x-cage-digest", std::string(64, '0')}}});
  expect_refused(spoilt([](Header& h) {
                   h.mutable_queries()->set_point_count(1000);
                   h.mutable_queries()->set_face_count(100);
                   h.mutable_queries()->set_corner_count(4'000'000'000u);
                 }),
                 kResourceExhausted, "header.queries");
  expect_works();
}

TEST_F(BadInput, Streams) {
  expect_refused({}, kInvalidArgument, "header");
  expect_refused({points(kPoint)}, kInvalidArgument, "header");
  expect_refused({v1::ComputeCoordinatesRequest()}, kInvalidArgument, "message");
  expect_refused({header(1), header(1), points(kPoint)}, kInvalidArgument, "header");
  expect_refused({header(1), points(kPoint), header(1)}, kInvalidArgument, "header");
  expect_refused({header(1), points(kPoint), points(kPoint)}, kInvalidArgument, "points.points.rows");
  expect_refused({header(2), points(kPoint)}, kInvalidArgument, "points");
  expect_refused({header(1)}, kInvalidArgument, "points");
  expect_refused({header(1), points({1, 2}, 2)}, kInvalidArgument, "points.points.columns");
  expect_refused({header(1), points({1, 2, std::nan("")})}, kInvalidArgument, "points[0]");
  expect_refused({header(1), points(kPoint), faces({3}, {0, 0, 0})}, kInvalidArgument, "faces.corner_counts.rows");
  auto meshed = header(1);
  meshed.mutable_header()->mutable_queries()->set_face_count(1);
  meshed.mutable_header()->mutable_queries()->set_corner_count(3);
  expect_refused({meshed, points(kPoint), faces({3}, {0, 0, 1})}, kInvalidArgument, "faces[0].corner[2]");
  expect_refused({meshed, points(kPoint), faces({2}, {0, 0})}, kInvalidArgument, "faces[0]");
  expect_refused({meshed, points(kPoint)}, kInvalidArgument, "faces");
  // Larger than one message may be: refused by gRPC itself, so without a field.
  expect_refused({header(1), points(std::vector<double>(30'000, 0.1))}, kResourceExhausted, "");
  expect_works();
}

TEST_F(BadInput, Uploads) {
  const auto upload = [&](const std::string& bytes, const std::string& expected_sha256 = "") {
    v1::UploadCageRequest request;
    request.set_piece(bytes);
    if (!expected_sha256.empty()) {
      request.mutable_expected_digest()->set_sha256(expected_sha256);
      request.mutable_expected_digest()->set_size_bytes(184);
    }
    v1::UploadCageResponse response;
    return client_->upload({request}, response);
  };
  EXPECT_EQ(upload("no cage at all").code, kInvalidArgument);
  EXPECT_EQ(upload("").field(), "cage.control_vertices");
  EXPECT_EQ(upload(tetrahedron().SerializeAsString(), std::string(32, 'x')).field(), "expected_digest");
  EXPECT_EQ(upload(tetrahedron().SerializeAsString(), "short").field(), "expected_digest.sha256");
  EXPECT_EQ(upload(std::string(50'000, 'x')).code, kResourceExhausted);
  v1::Cage cage = tetrahedron();
  *cage.mutable_triangles() = indices(3, {0, 1, 2, 0, 1, 57});
  EXPECT_EQ(upload(cage.SerializeAsString()).field(), "cage.triangles[1].vertex[2]");
  EXPECT_EQ(upload(tetrahedron().SerializeAsString()).code, kOk);

  v1::FindMissingCagesRequest question;
  v1::FindMissingCagesResponse reply;
  question.add_digests()->set_sha256("short");
  EXPECT_EQ(client_->find_missing(question, reply).field(), "digests[0].sha256");
  for (int i = 0; i < 2; ++i) question.add_digests();
  EXPECT_EQ(client_->find_missing(question, reply).field(), "digests");
  expect_works();
}

}  // namespace
}  // namespace barycast::server
