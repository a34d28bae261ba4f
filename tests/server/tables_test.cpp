// Tables through the service: rows are those of the library, cold or warm; filling ahead, and what it refuses.

#include <atomic>
#include <cmath>
#include <thread>

#include "bind/binding.h"
#include "decode.h"
#include "fixture.h"

namespace barycast::server {
namespace {

using namespace testing;
using std::chrono::milliseconds;

constexpr size_t kCount = 300;
constexpr double kWidth = 0.024;

class Tables : public ServerTest {
 protected:
  static v1::ComputeCoordinatesRequest request(const v1::Cage& cage) {
    auto head = header(kCount, cage);
    head.mutable_header()->mutable_options()->set_tables(true);
    return head;
  }
  // All of it, to compare bit by bit.
  static std::string row_bytes(const Answer& answer) {
    std::string bytes;
    for (const v1::RowBlock& block : answer.rows) bytes += block.SerializeAsString();
    return bytes;
  }
  Outcome upload(const v1::Cage& cage, v1::UploadCageResponse& response, const CallSettings& settings = {}) {
    v1::UploadCageRequest request;
    request.set_piece(cage.SerializeAsString());
    request.set_fill_tables(true);
    return client_->upload({request}, response, settings);
  }
  bool holds(const v1::Cage& cage) {
    const CageDigest digest = barycast::digest(decode_cage(cage, {})->input());
    v1::FindMissingCagesRequest request;
    request.add_digests()->set_sha256(digest.sha256.data(), digest.sha256.size());
    request.mutable_digests(0)->set_size_bytes(digest.size_bytes);
    v1::FindMissingCagesResponse response;
    EXPECT_EQ(client_->find_missing(request, response).code, kOk);
    return response.missing_size() == 0;
  }
};

// A thin bar: rows are not affine, and it takes a second to fill. Some hundred thousand tables fill a box.
v1::Cage closed_cage() {
  v1::Cage cage;
  std::vector<double> x;
  for (int v = 0; v < 8; ++v) x.insert(x.end(), {1.0 * (v >> 2), kWidth * (v >> 1 & 1), kWidth * (v & 1)});
  *cage.mutable_control_vertices() = doubles(3, x);
  *cage.mutable_quads() = indices(4, {0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3});
  return cage;
}

v1::Cage open_cage() {
  v1::Cage cage = closed_cage();
  *cage.mutable_quads() = indices(4, {0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4});
  return cage;
}

// Closed, of more triangles than are predicted.
v1::Cage large_cage() {
  std::vector<double> vertices;
  std::vector<uint32_t> triangles;
  for (uint32_t i = 0; i < 126; ++i) {
    const double x = 2.0 * i;
    vertices.insert(vertices.end(), {x, 0, 0, x + 1, 0, 0, x, 1, 0, x, 0, 1});
    for (const uint32_t v : {0u, 2u, 1u, 0u, 1u, 3u, 0u, 3u, 2u, 1u, 2u, 3u}) triangles.push_back(4 * i + v);
  }
  v1::Cage cage;
  *cage.mutable_control_vertices() = doubles(3, vertices);
  *cage.mutable_triangles() = indices(3, triangles);
  return cage;
}

// Inside, away from the cage and next to it; on it, and outside.
std::vector<double> everywhere() {
  std::vector<double> x;
  for (size_t i = 0; i + 4 < kCount; ++i) {
    const double t = (static_cast<double>(i) + 0.5) / kCount;
    x.insert(x.end(),
             {0.05 + 0.9 * t, kWidth * (0.5 + 0.1 * std::sin(20 * t)), kWidth * (0.5 + 0.1 * std::cos(31 * t))});
  }
  x.insert(x.end(), {0.3, 0.012, 0.001, 0.2, 0.012, 0.0075, 0.1, 0.0, 0.01, 2.0, -1.0, 0.5});
  return x;
}

TEST_F(Tables, RowsAreThoseOfTheLibrary) {
  for (const v1::Cage& cage : {closed_cage(), open_cage()}) {
    const Answer answer = client_->compute({request(cage), points(everywhere())});
    ASSERT_EQ(answer.code, kOk) << answer.message;
    EXPECT_TRUE(answer.header->options().tables());
    EXPECT_EQ(answer.header->options().estimator(), v1::ESTIMATOR_PREDICTED);
    EXPECT_EQ(answer.header->options().denoise(), v1::DENOISE_NONE);
    const auto index = CageIndex::create(decode_cage(cage, {})->input());
    ASSERT_TRUE(index.ok());
    Options options;
    options.tables = true;
    const Result<RowBlock> expected =
        bind_all(*index, {.points = everywhere(), .face_offsets = {}, .face_corners = {}}, *resolve(options, false));
    ASSERT_TRUE(expected.ok()) << expected.error().text();
    ASSERT_EQ(answer.rows.size(), 1u);
    EXPECT_EQ(numbers<double>(answer.rows[0].values()), expected->values);
    EXPECT_EQ(numbers<uint32_t>(answer.rows[0].indices()), expected->indices);
  }
}

TEST_F(Tables, ColdWarmAndFilledGiveTheSameBytes) {
  const Answer cold = client_->compute({request(closed_cage()), points(everywhere())});
  const Answer warm = client_->compute({request(closed_cage()), points(everywhere())});
  ASSERT_EQ(cold.code, kOk) << cold.message;
  EXPECT_FALSE(cold.header->cage_cache_hit());
  EXPECT_TRUE(warm.header->cage_cache_hit());
  EXPECT_EQ(row_bytes(cold), row_bytes(warm));
  // Most points take no walks of their own.
  EXPECT_LT(cold.summary->samples(), 12 * kCount / 2);

  start({});
  v1::UploadCageResponse first, second;
  const Outcome filled = upload(closed_cage(), first);
  ASSERT_EQ(filled.code, kOk) << filled.message;
  EXPECT_GT(first.tables(), 1000u);
  const Answer after = client_->compute({request(closed_cage()), points(everywhere())});
  ASSERT_EQ(after.code, kOk) << after.message;
  EXPECT_TRUE(after.header->cage_cache_hit());
  EXPECT_EQ(row_bytes(cold), row_bytes(after));
  ASSERT_EQ(upload(closed_cage(), second).code, kOk);
  EXPECT_EQ(second.tables(), first.tables()) << "all were there";

  auto without = request(closed_cage());
  without.mutable_header()->mutable_options()->set_tables(false);
  without.mutable_header()->mutable_options()->set_estimator(v1::ESTIMATOR_PREDICTED);
  EXPECT_NE(row_bytes(client_->compute({without, points(everywhere())})), row_bytes(cold));
}

// An upload that fills none counts what others made.
TEST_F(Tables, UploadsSayHowManyThereAre) {
  v1::UploadCageRequest plain;
  plain.set_piece(closed_cage().SerializeAsString());
  v1::UploadCageResponse before, after;
  ASSERT_EQ(client_->upload({plain}, before).code, kOk);
  EXPECT_EQ(before.tables(), 0u);
  ASSERT_EQ(client_->compute({request(closed_cage()), points(everywhere())}).code, kOk);
  ASSERT_EQ(client_->upload({plain}, after).code, kOk);
  EXPECT_GT(after.tables(), 0u);
}

TEST_F(Tables, AreRefusedBeforeAnythingIsBuilt) {
  v1::UploadCageResponse response;
  for (const v1::Cage& cage : {square(), open_cage(), large_cage()}) {
    const Outcome refused = upload(cage, response);
    EXPECT_EQ(refused.code, kInvalidArgument) << refused.message;
    EXPECT_EQ(refused.field(), "fill_tables");
    EXPECT_FALSE(holds(cage));
  }
  // Of an invalid cage it is the cage that is at fault.
  v1::Cage broken = closed_cage();
  *broken.mutable_triangles() = indices(3, {0, 1, 99});
  EXPECT_EQ(upload(broken, response).field(), "cage.triangles[0].vertex[2]");

  const std::string bytes = closed_cage().SerializeAsString();
  v1::UploadCageRequest first, second;
  first.set_piece(bytes.substr(0, 10));
  second.set_piece(bytes.substr(10));
  second.set_fill_tables(true);
  const Outcome late = client_->upload({first, second}, response);
  EXPECT_EQ(late.code, kInvalidArgument);
  EXPECT_EQ(late.field(), "fill_tables");
  first.set_fill_tables(true);
  second.set_fill_tables(false);
  EXPECT_EQ(client_->upload({first, second}, response).code, kOk);
  EXPECT_GT(response.tables(), 0u);
}

// What was made until the deadline stays, and the rest is made by whoever asks next.
TEST_F(Tables, ADeadlineStopsTheFilling) {
  DaemonSettings one;
  one.threads = 1;
  start(one);
  v1::UploadCageResponse response, all;
  const Outcome stopped = upload(closed_cage(), response, {.deadline = milliseconds(100), .metadata = {}});
  EXPECT_EQ(stopped.code, kDeadlineExceeded) << response.tables();
  EXPECT_TRUE(eventually([&] { return !daemon_->busy(); }, std::chrono::seconds(5)));
  EXPECT_EQ(counters().calls_cancelled, 1u);
  expect_works();
  ASSERT_EQ(upload(closed_cage(), all).code, kOk);
  const Answer answer = client_->compute({request(closed_cage()), points(everywhere())});
  start({});
  EXPECT_EQ(row_bytes(answer), row_bytes(client_->compute({request(closed_cage()), points(everywhere())})));
}

TEST_F(Tables, FillingLetsOthersPass) {
  std::atomic<bool> filled = false;
  v1::UploadCageResponse response;
  std::thread other([&] {
    EXPECT_EQ(upload(closed_cage(), response).code, kOk);
    filled = true;
  });
  int passed = 0;
  while (!filled && passed < 5) {
    expect_works();
    ++passed;
  }
  other.join();
  EXPECT_GE(passed, 2);
}

TEST_F(Tables, FillingIsAdmittedByItsMemory) {
  DaemonSettings settings;
  settings.admission.requests_max = 1;
  start(settings);
  v1::UploadCageResponse response;
  EXPECT_EQ(upload(closed_cage(), response).code, kOk);
  settings.admission.requests_max = 64;
  settings.limits.cage_bytes_max = 10'000;
  settings.admission.bytes_max = 1 << 20;  // enough for the pieces and a small request, and too little for a prediction
  start(settings);
  const std::unique_ptr<Stream> other = client_->open();
  auto head = header(1);
  head.mutable_header()->mutable_options()->set_samples(1);
  head.mutable_header()->mutable_options()->set_estimator(v1::ESTIMATOR_SAMPLING);
  other->write(head);
  ASSERT_TRUE(eventually([&] { return holds(tetrahedron()); }));
  const Outcome busy = upload(closed_cage(), response);
  EXPECT_EQ(busy.code, kResourceExhausted) << busy.message;
  EXPECT_TRUE(busy.has_retry());
  EXPECT_FALSE(holds(closed_cage()));
  other->cancel();
  other->finish();
  settings.limits.request_bytes_max = 200'000;
  start(settings);
  const Outcome never = upload(closed_cage(), response);
  EXPECT_EQ(never.code, kResourceExhausted);
  EXPECT_EQ(never.field(), "fill_tables");
  EXPECT_FALSE(never.has_retry());
}

// Where the cache is too small for the tables the cage goes, and the answer says so.
TEST_F(Tables, ACageThatOutgrowsTheCacheIsNotKept) {
  DaemonSettings settings;
  settings.cache_bytes_max = 2 << 20;
  start(settings);
  v1::UploadCageResponse response;
  const Outcome outcome = upload(closed_cage(), response);
  EXPECT_EQ(outcome.code, kResourceExhausted);
  EXPECT_EQ(outcome.field(), "fill_tables");
  EXPECT_FALSE(holds(closed_cage()));
}

}  // namespace
}  // namespace barycast::server
