// What a well-behaved client sees.

#include <unistd.h>

#include <cmath>
#include <future>

#include "decode.h"
#include "fixture.h"

namespace barycast::server {
namespace {

using namespace testing;

class Service : public ServerTest {};

v1::CageDigest digest_of(const v1::Cage& cage) {
  const CageDigest digest = barycast::digest(decode_cage(cage, {})->input());
  v1::CageDigest result;
  result.set_sha256(digest.sha256.data(), digest.sha256.size());
  result.set_size_bytes(digest.size_bytes);
  return result;
}

std::string hexadecimal_of(const v1::Cage& cage) {
  return hexadecimal(barycast::digest(decode_cage(cage, {})->input()));
}

v1::UploadCageRequest piece(const std::string& bytes) {
  v1::UploadCageRequest request;
  request.set_piece(bytes);
  return request;
}

// All rows as bytes, to compare answers bit by bit.
std::string row_bytes(const Answer& answer) {
  std::string bytes;
  for (const v1::RowBlock& block : answer.rows) bytes += block.SerializeAsString();
  return bytes;
}

TEST_F(Service, TetrahedronHasItsAffineCoordinates) {
  const size_t count = 1000;
  const std::vector<double> x = inner_points(count);
  auto head = header(count);
  head.mutable_header()->mutable_output()->set_gradients(true);
  head.mutable_header()->mutable_output()->set_block_rows(64);
  const Answer answer =
      client_->compute({head, points({x.begin(), x.begin() + 900}), points({x.begin() + 900, x.end()})});
  ASSERT_EQ(answer.code, kOk) << answer.message;
  ASSERT_TRUE(answer.header && answer.summary);
  EXPECT_EQ(answer.header->control_vertex_count(), 4u);
  EXPECT_EQ(answer.header->output().block_rows(), 64u);
  EXPECT_EQ(answer.header->options().samples(), 12u);
  EXPECT_EQ(answer.header->options().estimator(), v1::ESTIMATOR_PREDICTED);
  EXPECT_EQ(answer.header->options().coordinates(), v1::COORDINATE_KIND_HARMONIC);
  EXPECT_EQ(answer.header->cage_digest().sha256(), digest_of(tetrahedron()).sha256());
  EXPECT_GT(answer.header->numerics_version(), 0u);
  EXPECT_EQ(answer.rows.size(), 16u);
  size_t row = 0;
  for (const v1::RowBlock& block : answer.rows) {
    EXPECT_EQ(block.first_row(), row);
    const auto offsets = numbers<uint32_t>(block.offsets());
    const auto columns = numbers<uint32_t>(block.indices());
    const auto values = numbers<double>(block.values());
    const auto gradients = numbers<double>(block.gradients());
    ASSERT_EQ(gradients.size(), 3 * values.size());
    ASSERT_EQ(block.flags().size() + 1, offsets.size());
    for (size_t i = 0; i + 1 < offsets.size(); ++i, ++row) {
      const double* p = &x[3 * row];
      const double expected[4] = {1 - p[0] - p[1] - p[2], p[0], p[1], p[2]};
      for (uint32_t k = offsets[i]; k < offsets[i + 1]; ++k) {
        EXPECT_NEAR(values[k], expected[columns[k]], 1e-11);
        for (uint32_t j = 0; j < 3; ++j) {
          EXPECT_NEAR(gradients[3 * k + j], columns[k] == 0 ? -1 : columns[k] - 1 == j ? 1 : 0, 1e-9);
        }
      }
    }
  }
  EXPECT_EQ(row, count);
  EXPECT_EQ(answer.summary->row_count(), count);
  EXPECT_GT(answer.summary->samples(), 0u);
  EXPECT_LE(answer.summary->linear_precision_error_max(), 1e-12);
}

TEST_F(Service, PlaneAndFloat32) {
  auto head = header(1, square());
  head.mutable_header()->mutable_output()->clear_type();
  const Answer answer = client_->compute({head, points({0.25, 0.5}, 2)});
  ASSERT_EQ(answer.code, kOk) << answer.message;
  const auto values = numbers<float>(answer.rows.at(0).values());
  const auto columns = numbers<uint32_t>(answer.rows.at(0).indices());
  double x = 0, y = 0;
  for (size_t i = 0; i < values.size(); ++i) {
    x += values[i] * (columns[i] == 1 || columns[i] == 2);
    y += values[i] * (columns[i] >= 2);
  }
  EXPECT_NEAR(x, 0.25, 1e-6);
  EXPECT_NEAR(y, 0.5, 1e-6);
}

TEST_F(Service, DenoisesOverFaces) {
  auto head = header(4);
  head.mutable_header()->mutable_queries()->set_face_count(1);
  head.mutable_header()->mutable_queries()->set_corner_count(4);
  const std::vector<double> x = {0.1, 0.1, 0.1, 0.2, 0.1, 0.1, 0.2, 0.2, 0.1, 0.1, 0.2, 0.1};
  const Answer answer = client_->compute({head, points(x), faces({4}, {0, 1, 2, 3})});
  ASSERT_EQ(answer.code, kOk) << answer.message;
  EXPECT_EQ(answer.header->options().denoise(), v1::DENOISE_MESH);
  EXPECT_GT(answer.header->options().smoothing_time(), 0.0);
  EXPECT_EQ(answer.summary->row_count(), 4u);
}

TEST_F(Service, MissingThenUploadThenHit) {
  const std::string hex = hexadecimal_of(tetrahedron());
  auto head = header(1);
  *head.mutable_header()->mutable_cage_digest() = digest_of(tetrahedron());
  const Answer missing = client_->compute({head, points({0.1, 0.2, 0.3})});
  EXPECT_EQ(missing.code, kFailedPrecondition);
  EXPECT_EQ(missing.missing(), hex);
  v1::FindMissingCagesRequest question;
  *question.add_digests() = digest_of(tetrahedron());
  v1::FindMissingCagesResponse reply;
  EXPECT_EQ(client_->find_missing(question, reply).code, kOk);
  EXPECT_EQ(reply.missing_size(), 1);

  const std::string bytes = tetrahedron().SerializeAsString();
  v1::UploadCageResponse uploaded;
  v1::UploadCageRequest first = piece(bytes.substr(0, 10));
  *first.mutable_expected_digest() = digest_of(tetrahedron());
  const Outcome upload = client_->upload({first, piece(bytes.substr(10))}, uploaded);
  ASSERT_EQ(upload.code, kOk) << upload.message;
  EXPECT_EQ(uploaded.digest().sha256(), digest_of(tetrahedron()).sha256());

  EXPECT_EQ(client_->find_missing(question, reply).code, kOk);
  EXPECT_EQ(reply.missing_size(), 0);
  const Answer answer = client_->compute({head, points({0.1, 0.2, 0.3})}, {.metadata = {{"x-cage-digest", hex}}});
  ASSERT_EQ(answer.code, kOk) << answer.message;
  EXPECT_TRUE(answer.header->cage_cache_hit());
}

TEST_F(Service, HitAndMissGiveTheSameBytes) {
  const std::vector<double> x = inner_points(200);
  const Answer miss = client_->compute({header(200, tetrahedron(2)), points(x)});
  const Answer hit = client_->compute({header(200, tetrahedron(2)), points(x)});
  ASSERT_EQ(miss.code, kOk) << miss.message;
  EXPECT_FALSE(miss.header->cage_cache_hit());
  EXPECT_TRUE(hit.header->cage_cache_hit());
  EXPECT_EQ(row_bytes(miss), row_bytes(hit));
}

TEST_F(Service, OdditiesAreWarnings) {
  v1::Cage cage = tetrahedron();
  *cage.mutable_control_vertices() = doubles(3, {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 5, 5, 5});
  const Answer answer = client_->compute({header(1, cage), points({0.1, 0.2, 0.3})});
  ASSERT_EQ(answer.code, kOk) << answer.message;
  ASSERT_GE(answer.summary->warnings_size(), 1);
  EXPECT_NE(answer.summary->warnings(0).field().find("cage.control_vertices"), std::string::npos);
}

TEST_F(Service, CapabilitiesListOnlyWhatIsBuilt) {
  v1::GetCapabilitiesResponse reply;
  ASSERT_EQ(client_->capabilities(reply).code, kOk);
  std::vector<int> listed(reply.coordinates().begin(), reply.coordinates().end()), accepted;
  for (int kind = v1::COORDINATE_KIND_HARMONIC; v1::CoordinateKind_IsValid(kind); ++kind) {
    auto head = header(1);
    head.mutable_header()->mutable_options()->set_coordinates(static_cast<v1::CoordinateKind>(kind));
    if (client_->compute({head, points({0.1, 0.2, 0.3})}).code != kUnimplemented) accepted.push_back(kind);
  }
  EXPECT_EQ(listed, accepted);
  EXPECT_EQ(reply.presets_size(), 2);
  ASSERT_EQ(reply.elements_size(), 2);
  EXPECT_EQ(reply.elements(0).kinds_size(), 1);
  EXPECT_EQ(reply.elements(1).kinds_size(), 3);
  EXPECT_GT(reply.limits().points_max(), 0u);
  EXPECT_FALSE(reply.build_version().empty());
}

TEST_F(Service, Health) {
  EXPECT_EQ(client_->health(""), "SERVING");
  EXPECT_EQ(client_->health("barycast.v1.BarycastService"), "SERVING");
  EXPECT_EQ(client_->health("no.such.Service"), "5");
  EXPECT_EQ(probe(daemon_->address(), std::chrono::seconds(10)), Health::kServing);
  daemon_->begin_drain();
  EXPECT_EQ(client_->health(""), "NOT_SERVING");
  EXPECT_EQ(client_->health("barycast.v1.BarycastService"), "NOT_SERVING");
  EXPECT_EQ(probe(daemon_->address(), std::chrono::seconds(10)), Health::kNotServing);
}

TEST_F(Service, WatchersSeeTheDrain) {
  for (const std::string name : {"", "barycast.v1.BarycastService"}) {
    start({});
    const std::string states = client_->watch(name, 2, [this](int i) {
      if (i == 0) daemon_->begin_drain();
    });
    EXPECT_EQ(states, "SERVING,NOT_SERVING") << name;
  }
}

// Live is not ready: until the self-test has passed the server listens, says NOT_SERVING and computes nothing.
TEST_F(Service, IsNotReadyBeforeItsSelfTestHasPassed) {
  const std::string address = "unix:" + ::testing::TempDir() + "barycast_ready_" + std::to_string(getpid());
  std::promise<void> release;
  DaemonSettings settings;
  settings.listen = address;
  settings.self_test = [&release]() -> Status {
    release.get_future().wait();
    return Done{};
  };
  std::unique_ptr<Daemon> daemon;
  std::thread starter([&] {
    Result<std::unique_ptr<Daemon>> started = Daemon::start(settings);
    if (started.ok()) daemon = std::move(*started);
  });
  Client client(address);
  EXPECT_TRUE(eventually([&] { return client.health("barycast.v1.BarycastService") == "NOT_SERVING"; }));
  EXPECT_EQ(client.health(""), "NOT_SERVING");
  EXPECT_EQ(probe(address, std::chrono::seconds(10)), Health::kNotServing);
  EXPECT_EQ(client.compute({header(1), points({0.1, 0.2, 0.3})}).code, kUnavailable);
  v1::EstimateCostResponse cost;
  EXPECT_EQ(client.estimate({}, cost).code, kUnavailable);
  const std::string states =
      client.watch("barycast.v1.BarycastService", 2, [&](int i) { i == 0 ? release.set_value() : void(); });
  EXPECT_EQ(states, "NOT_SERVING,SERVING");
  starter.join();
  EXPECT_EQ(client.health(""), "SERVING");
  EXPECT_EQ(client.compute({header(1), points({0.1, 0.2, 0.3})}).code, kOk);
}

TEST_F(Service, DoesNotStartWhenItsSelfTestFails) {
  DaemonSettings settings;
  settings.listen = "127.0.0.1:0";
  settings.self_test = [] { return Status(Error{ErrorCode::kInternal, "", "self-test failed: of course"}); };
  const Result<std::unique_ptr<Daemon>> started = Daemon::start(settings);
  ASSERT_FALSE(started.ok());
  EXPECT_EQ(started.error().message, "self-test failed: of course");
}

}  // namespace
}  // namespace barycast::server
