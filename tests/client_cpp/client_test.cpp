// The verbs with the real daemon, started privately.

#include "barycast/client/client.h"

#include <gtest/gtest.h>

#include <limits>
#include <thread>

#include "barycast/client/local_server.h"
#include "shapes.h"

namespace barycast::client::testing {
namespace {

using std::chrono::milliseconds;

class Verbs : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    Result<std::unique_ptr<LocalServer>> started = LocalServer::start({.program = BARYCASTD, .threads = 2});
    ASSERT_TRUE(started) << started.error().text();
    server_ = std::move(*started);
  }
  static void TearDownTestSuite() { server_.reset(); }

  Points points() const { return {std::span<const double>(positions_), 3}; }

  static std::unique_ptr<LocalServer> server_;
  Client client_{{.address = server_->address()}};
  const std::vector<double> positions_ = points_inside(500);
  const Faces no_faces_;
};

std::unique_ptr<LocalServer> Verbs::server_;

TEST_F(Verbs, Capabilities) {
  const Result<Capabilities> result = client_.capabilities();
  ASSERT_TRUE(result) << result.error().text();
  EXPECT_EQ(result->coordinates.front(), Coordinates::kHarmonic);
  EXPECT_GT(result->message_bytes_max, 0u);
  EXPECT_GT(result->numerics_version, 0u);
  EXPECT_FALSE(result->build_version.empty());
  EXPECT_TRUE(client_.answered());
}

TEST_F(Verbs, UploadAnswersOurDigest) {
  const Result<Uploaded> result = client_.upload(box());
  ASSERT_TRUE(result) << result.error().text();
  EXPECT_EQ(result->digest, box().digest());
}

TEST_F(Verbs, UploadFillsTablesAndBindTakesThem) {
  // A bar, which takes a second to fill.
  CageParts parts = box_parts();
  std::vector<double> x = positions_;
  for (std::vector<double>* all : {&parts.control_vertices, &x})
    for (size_t i = 0; i < all->size(); ++i)
      if (i % 3 > 0) (*all)[i] *= 0.024;
  const Cage bar = Cage::create(parts).value();
  const Points inside{std::span<const double>(x), 3};
  const ComputeOptions options{.estimator = Estimator::kPredicted, .tables = true, .type = DataType::kFloat64};
  const Result<Binding> cold = client_.bind(bar, inside, no_faces_, options);
  ASSERT_TRUE(cold) << cold.error().text();
  EXPECT_TRUE(cold->report.options.tables);
  EXPECT_LT(cold->report.samples, 500u * 12);
  const Result<Uploaded> some = client_.upload(bar), all = client_.upload(bar, {.fill_tables = true});
  ASSERT_TRUE(some && all) << all.error().text();
  EXPECT_GT(some->tables, 0u);
  EXPECT_GT(all->tables, some->tables);
  EXPECT_EQ(client_.bind(bar, inside, no_faces_, options)->values, cold->values);

  ComputeOptions sampled = options;
  sampled.estimator = Estimator::kSampling;
  EXPECT_EQ(client_.bind(bar, inside, no_faces_, sampled).error().field, "header.options.tables");
  parts.quads.resize(5 * 4);
  const Result<Cage> open = Cage::create(parts);
  ASSERT_TRUE(open);
  const Result<Uploaded> refused = client_.upload(*open, {.fill_tables = true});
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Code::kInvalidArgument);
  EXPECT_EQ(refused.error().field, "fill_tables");
}

TEST_F(Verbs, AnInvalidCageIsRefusedWithItsField) {
  const Result<Cage> flat = Cage::create({.control_vertices = {0, 0, 0, 1, 0, 0, 0, 1, 0}, .triangles = {0, 1, 2}});
  const Result<Uploaded> result = client_.upload(*flat);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, Code::kInvalidArgument);
  EXPECT_TRUE(result.error().is_input);
  EXPECT_TRUE(result.error().field.starts_with("cage")) << result.error().text();
}

TEST_F(Verbs, EstimateSaysWhatItWouldCost) {
  const Result<Cost> cost = client_.estimate(box(), {.points = 1000}, {});
  ASSERT_TRUE(cost) << cost.error().text();
  EXPECT_GT(cost->memory_bytes, 0u);
  EXPECT_EQ(cost->samples, 12'000u);
}

TEST_F(Verbs, BindReproducesThePointsAndRepeats) {
  const ComputeOptions options{.samples = 20, .seed = 3, .type = DataType::kFloat64, .gradients = true};
  const Result<Binding> binding = client_.bind(box(), points(), no_faces_, options);
  ASSERT_TRUE(binding) << binding.error().text();
  EXPECT_EQ(binding->point_count(), 500u);
  EXPECT_EQ(binding->control_vertex_count(), 8u);
  EXPECT_EQ(binding->cage_digest, box().digest().hexadecimal());
  EXPECT_EQ(std::get<std::vector<double>>(binding->gradients).size(), 3 * binding->indices.size());
  EXPECT_EQ(binding->report.options.samples, 20u);
  EXPECT_EQ(binding->report.options.denoise, Denoise::kNone);
  EXPECT_EQ(binding->report.samples, 500u * 20);
  EXPECT_EQ(binding->report.seconds.back().first, "total");
  const Result<std::vector<double>> moved = deform(*binding, box_vertices());
  ASSERT_TRUE(moved);
  for (size_t i = 0; i < positions_.size(); ++i) EXPECT_NEAR((*moved)[i], positions_[i], 1e-11);
  EXPECT_EQ(client_.bind(box(), points(), no_faces_, options)->values, binding->values);
}

TEST_F(Verbs, FloatPointsAreTheSamePointsInDouble) {
  const std::vector<float> narrow(positions_.begin(), positions_.end());
  const std::vector<double> wide(narrow.begin(), narrow.end());
  const Result<Binding> first = client_.bind(box(), {std::span<const float>(narrow), 3}, no_faces_);
  const Result<Binding> second = client_.bind(box(), {std::span<const double>(wide), 3}, no_faces_);
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->values, second->values);
}

TEST_F(Verbs, ComputeHandsOverBlocksInOrder) {
  uint64_t next = 0;
  int progress = 0;
  const ComputeCallbacks callbacks{.on_rows =
                                       [&](const RowBlock& block) {
                                         EXPECT_EQ(block.first_row, next);
                                         EXPECT_LE(block.flags.size(), 100u);
                                         next += block.flags.size();
                                         return true;
                                       },
                                   .on_progress = [&](const Progress&) { ++progress; }};
  const Result<Report> report =
      client_.compute(box(), points(), no_faces_, {.samples = 500, .block_rows = 100}, callbacks);
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_EQ(next, 500u);
  EXPECT_EQ(report->points, 500u);
}

TEST_F(Verbs, TheReceiverCancels) {
  int blocks = 0;
  const ComputeCallbacks callbacks{.on_rows = [&](const RowBlock&) { return ++blocks < 2; }};
  const Result<Report> report = client_.compute(box(), points(), no_faces_, {.block_rows = 10}, callbacks);
  ASSERT_FALSE(report);
  EXPECT_EQ(report.error().code, Code::kCancelled);
  EXPECT_EQ(blocks, 2);
}

TEST_F(Verbs, AStopTokenCancels) {
  std::stop_source source;
  const std::jthread later([&] {
    std::this_thread::sleep_for(milliseconds(300));
    source.request_stop();
  });
  const auto start = std::chrono::steady_clock::now();
  const Result<Binding> binding =
      client_.bind(box(), points(), no_faces_, {.samples = 100'000}, {}, source.get_token());
  ASSERT_FALSE(binding);
  EXPECT_EQ(binding.error().code, Code::kCancelled);
  EXPECT_LT(std::chrono::steady_clock::now() - start, milliseconds(5000));
  const Result<Capabilities> stopped = Client({.address = server_->address()}).capabilities(source.get_token());
  ASSERT_FALSE(stopped);
  EXPECT_EQ(stopped.error().code, Code::kCancelled);
}

TEST_F(Verbs, TheDeadlineIsOverAllAttempts) {
  Client hurried({.address = server_->address(), .time_max = milliseconds(300)});
  const auto start = std::chrono::steady_clock::now();
  const Result<Binding> binding = hurried.bind(box(), points(), no_faces_, {.samples = 100'000});
  ASSERT_FALSE(binding);
  EXPECT_EQ(binding.error().code, Code::kDeadlineExceeded);
  EXPECT_FALSE(binding.error().is_input);
  EXPECT_LT(std::chrono::steady_clock::now() - start, milliseconds(5000));
}

TEST_F(Verbs, BadPointsAreRefusedHere) {
  const auto field = [&](std::vector<double> positions, uint32_t dimension, const Faces& faces = {}) {
    const Result<Binding> binding = client_.bind(box(), {std::span<const double>(positions), dimension}, faces);
    return binding ? "none" : binding.error().field;
  };
  EXPECT_EQ(field({}, 3), "points");
  EXPECT_EQ(field({0.5, 0.5}, 2), "points");
  EXPECT_EQ(field({0.5, 0.5}, 0), "points");
  EXPECT_EQ(field({0.5, 0.5, 0.5, 0.5}, 3), "points");
  EXPECT_EQ(field({0, 0, 0, 0, std::numeric_limits<double>::quiet_NaN(), 0}, 3), "points[1]");
  EXPECT_EQ(field({0.5, 0.5, 0.5}, 3, {.offsets = {0, 3}, .corners = {0, 0, 1}}), "faces.corners[2]");
}

TEST_F(Verbs, BadOptionsAreRefusedThere) {
  const Result<Binding> binding = client_.bind(box(), points(), no_faces_, {.thickness = 0.5});
  ASSERT_FALSE(binding);
  EXPECT_EQ(binding.error().code, Code::kInvalidArgument);
  EXPECT_TRUE(binding.error().field.ends_with("thickness")) << binding.error().text();
}

TEST_F(Verbs, ThreadsShareAClient) {
  const Result<Binding> expected = client_.bind(box(), points(), no_faces_);
  ASSERT_TRUE(expected);
  std::vector<std::jthread> threads;
  std::vector<Reals> values(4);
  for (Reals& mine : values) {
    threads.emplace_back([&] { mine = std::move(client_.bind(box(), points(), no_faces_)->values); });
  }
  threads.clear();
  for (const Reals& mine : values) EXPECT_EQ(mine, expected->values);
}

TEST(Nobody, Answers) {
  Client client({.address = "unix:/nowhere/socket", .retry_time_max = milliseconds(500)});
  const auto start = std::chrono::steady_clock::now();
  const Result<Capabilities> result = client.capabilities();
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, Code::kUnavailable);
  EXPECT_FALSE(result.error().is_input);
  EXPECT_NE(result.error().message.find("is barycastd running, and the address right?"), std::string::npos);
  EXPECT_FALSE(client.answered());
  EXPECT_LT(std::chrono::steady_clock::now() - start, milliseconds(10'000));
}

TEST(Addresses, AreTaken) {
  const char* const addresses[] = {
      "127.0.0.1:1",    "localhost:65535",      "my_host:50051",  "[::1]:50051",
      "unix:socket",    "unix:///a/b",          "unix:/a b",      "unix-abstract:name",
      "dns:host:50051", "dns:///host:50051",    "dns:///[::1]:1", "dns://8.8.8.8/host:50051",
      "ipv4:1.2.3.4:1", "ipv4:127.0.0.1:1,h:2", "ipv4:///h:1",    "ipv6:[::1]:50051",
      "vsock:2:50051",  "ipv6:%5B::1%5D:50051", "xds:///service",
  };
  for (const char* address : addresses) EXPECT_TRUE(check_address(address)) << address;
}

TEST(Addresses, ThatNoServerHasAreRefusedByEveryVerbAtOnce) {
  const char* const addresses[] = {
      "",
      "127.0.0.1",
      "127.0.0.1:",
      "127.0.0.1:port",
      "127.0.0.1:0",
      ":50051",
      "127.0.0.1:65536",
      "127.0.0.1:-1",
      "127.0.0.1:50051/",
      "127.0.0.1:99999999999999999999",
      "50051",
      "::1:50051",
      "http://1.2.3.4:50051",
      "[::1]",
      "a b:50051",
      "unix:",
      "dns:",
      "dns:/",
      "dns://",
      "dns:///",
      "dns:///h:",
      "dns:///host",
      "ipv4:127.0.0.1:1,",
      "passthrough:///h:1",
  };
  const std::vector<double> points = points_inside(3);
  const auto refused = [](const auto& result) {
    return !result && result.error().is_input && result.error().field == "server";
  };
  for (const char* address : addresses) {
    EXPECT_TRUE(refused(check_address(address))) << address;
    Client client({.address = address});
    EXPECT_TRUE(refused(client.capabilities())) << address;
    EXPECT_TRUE(refused(client.upload(box()))) << address;
    EXPECT_TRUE(refused(client.estimate(box(), {.points = 3}, {}))) << address;
    EXPECT_TRUE(refused(client.bind(box(), {std::span<const double>(points), 3}, {}))) << address;
  }
}

TEST(LocalServer, SaysWhatIsWrong) {
  const auto error = [](const std::string& program, milliseconds time = milliseconds(20'000)) {
    const auto started = LocalServer::start({.program = program, .start_time_max = time});
    return started ? "none" : started.error().text();
  };
  EXPECT_NE(error("/nowhere/barycastd").find("cannot be started"), std::string::npos);
  EXPECT_NE(error("/bin/false").find("ended at start with status 1"), std::string::npos);
  std::stop_source source;
  source.request_stop();
  EXPECT_EQ(LocalServer::start({.program = BARYCASTD}, source.get_token()).error().code, Code::kCancelled);
}

}  // namespace
}  // namespace barycast::client::testing
