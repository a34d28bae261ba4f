// Streams that end badly or slowly: cancellation, deadlines, slow readers, overload, drain. Every wait is
// bounded; no bound is tight.

#include <algorithm>

#include "fixture.h"

namespace barycast::server {
namespace {

using namespace testing;
using std::chrono::milliseconds;

constexpr uint32_t kSamplesMany = 2000;
constexpr uint32_t kSamplesHuge = 100'000;

class Streams : public ServerTest {
 protected:
  // Minutes of work, in many points or in many samples for each. Returns once the server computes.
  std::unique_ptr<Stream> start_long_call(uint32_t samples, const CallSettings& settings = {}) {
    const size_t count = 100'000;
    auto head = header(count);
    head.mutable_header()->mutable_options()->set_samples(samples);
    // A prediction would be made first, which takes seconds under a sanitizer on a busy machine.
    head.mutable_header()->mutable_options()->set_estimator(v1::ESTIMATOR_SAMPLING);
    std::unique_ptr<Stream> stream = client_->open(settings);
    stream->write(head);
    stream->write(points(inner_points(count)));
    stream->half_close();
    EXPECT_TRUE(eventually([&] { return counters().steps > 0; }));
    return stream;
  }

  void expect_idle() {
    EXPECT_TRUE(eventually([&] { return !daemon_->busy(); }));
    const uint64_t steps = counters().steps;
    std::this_thread::sleep_for(milliseconds(200));
    EXPECT_EQ(counters().steps, steps);
  }
};

TEST_F(Streams, CancelStopsTheWork) {
  const auto stream = start_long_call(kSamplesHuge);
  v1::ComputeCoordinatesResponse response;
  ASSERT_TRUE(stream->read(response));
  EXPECT_TRUE(response.has_header());
  stream->cancel();
  EXPECT_EQ(stream->finish().code, kCancelled);
  expect_idle();
  EXPECT_EQ(counters().calls_cancelled, 1u);
  expect_works();
}

TEST_F(Streams, DeadlineStopsTheWork) {
  const auto stream = start_long_call(kSamplesHuge, {.deadline = milliseconds(1500), .metadata = {}});
  EXPECT_EQ(stream->finish().code, kDeadlineExceeded);
  expect_idle();
  EXPECT_EQ(counters().calls_cancelled, 1u);
  expect_works();
}

TEST_F(Streams, CancelWhileSendingLeavesNothing) {
  const auto stream = client_->open();
  stream->write(header(10));
  stream->write(points(inner_points(5)));
  ASSERT_TRUE(eventually([&] { return daemon_->busy(); }));
  stream->cancel();
  EXPECT_EQ(stream->finish().code, kCancelled);
  expect_idle();
  EXPECT_EQ(counters().steps, 0u);
  EXPECT_EQ(counters().calls_cancelled, 1u);
}

TEST_F(Streams, ManyCancelsAtAllTimes) {
  const size_t count = 2000;
  for (int i = 0; i < 60; ++i) {
    const auto stream = client_->open();
    auto head = header(count);
    head.mutable_header()->mutable_output()->set_block_rows(64);
    stream->write(head);
    if (i % 3 > 0) stream->write(points(inner_points(count)));
    if (i % 3 > 1) stream->half_close();
    std::this_thread::sleep_for(std::chrono::microseconds(300 * i));
    stream->cancel();
    stream->finish();
  }
  expect_idle();
  expect_works();
}

TEST_F(Streams, SmallRequestsPassLongOnes) {
  const auto a = start_long_call(kSamplesMany);
  const auto b = start_long_call(kSamplesMany);
  expect_works();
  a->cancel();
  b->cancel();
  a->finish();
  b->finish();
  expect_idle();
}

// The client reads nothing: what is produced stays within the window (two blocks, and what the transport
// takes, less than one) and is all there when it reads on.
TEST_F(Streams, ASlowReaderStopsProduction) {
  const size_t count = 100'000;
  auto head = header(count);
  head.mutable_header()->mutable_options()->set_samples(1);
  head.mutable_header()->mutable_output()->set_gradients(true);
  head.mutable_header()->mutable_output()->set_block_rows(2000);  // 50 blocks of about 300 kB
  const auto stream = client_->open();
  stream->write(head);
  stream->write(points(inner_points(count)));
  stream->half_close();
  ASSERT_TRUE(eventually([&] { return counters().blocks_produced >= 2; }));
  uint64_t seen = 0;
  ASSERT_TRUE(eventually([&] {
    const uint64_t before = std::exchange(seen, counters().blocks_produced.load());
    std::this_thread::sleep_for(milliseconds(500));
    return before == seen;
  }));
  EXPECT_LE(seen, 4u);
  EXPECT_TRUE(daemon_->busy());
  expect_works();
  uint64_t rows = 0;
  for (v1::ComputeCoordinatesResponse response; stream->read(response);)
    rows += static_cast<uint64_t>(response.rows().flags().size());
  EXPECT_EQ(rows, count);
  EXPECT_EQ(stream->finish().code, kOk);
  EXPECT_EQ(counters().blocks_produced, 51u);  // and one of expect_works
}

TEST_F(Streams, AReaderThatLeavesFreesItsPlace) {
  const size_t count = 100'000;
  auto head = header(count);
  head.mutable_header()->mutable_options()->set_samples(1);
  head.mutable_header()->mutable_output()->set_gradients(true);
  const auto stream = client_->open();
  stream->write(head);
  stream->write(points(inner_points(count)));
  stream->half_close();
  ASSERT_TRUE(eventually([&] { return counters().blocks_produced >= 2; }));
  stream->cancel();
  stream->finish();
  expect_idle();
}

TEST_F(Streams, RefusesWhatIsTooMuchAtOnce) {
  DaemonSettings settings;
  settings.admission.requests_max = 1;
  start(settings);
  const auto holder = start_long_call(kSamplesMany);
  const Answer answer = client_->compute({header(1), points({0.1, 0.2, 0.3})});
  EXPECT_EQ(answer.code, kResourceExhausted);
  EXPECT_TRUE(answer.has_retry());
  holder->cancel();
  holder->finish();
  expect_idle();
  expect_works();
}

// A client that holds a place and says nothing gives it up; one that goes on in time does not.
TEST_F(Streams, SilentClientsGiveUpTheirPlaces) {
  DaemonSettings settings;
  settings.admission.requests_max = 2;
  settings.limits.receive_idle_max = milliseconds(1500);
  start(settings);
  const auto silent_after_header = client_->open();
  silent_after_header->write(header(1));
  const auto slow = client_->open();
  slow->write(header(4));
  for (int i = 0; i < 4; ++i) {
    std::this_thread::sleep_for(milliseconds(600));
    slow->write(points({0.1, 0.2, 0.3}));
  }
  slow->half_close();
  EXPECT_EQ(slow->finish().code, kOk);
  const Outcome silent = silent_after_header->finish();
  EXPECT_EQ(silent.code, kCancelled);
  EXPECT_NE(silent.message.find("nothing arrived for 1500 ms"), std::string::npos) << silent.message;
  const auto silent_from_the_start = client_->open();
  EXPECT_EQ(silent_from_the_start->finish().code, kCancelled);
  expect_idle();
  expect_works();
}

TEST_F(Streams, DrainRefusesNewCallsAndFinishesRunningOnes) {
  const auto stream = client_->open();
  stream->write(header(1));
  ASSERT_TRUE(eventually([&] { return daemon_->busy(); }));
  daemon_->begin_drain();
  EXPECT_EQ(client_->compute({header(1), points({0.1, 0.2, 0.3})}).code, kUnavailable);
  v1::UploadCageResponse response;
  EXPECT_EQ(client_->upload({}, response).code, kUnavailable);
  stream->write(points({0.1, 0.2, 0.3}));
  stream->half_close();
  EXPECT_EQ(stream->finish().code, kOk);
  EXPECT_TRUE(eventually([&] { return !daemon_->busy(); }));
  daemon_->stop(milliseconds(1000));
}

TEST_F(Streams, StopCancelsWhatStillRuns) {
  const auto stream = start_long_call(kSamplesMany);
  daemon_->stop(milliseconds(100));
  EXPECT_NE(stream->finish().code, kOk);
  EXPECT_FALSE(daemon_->busy());
  EXPECT_EQ(counters().calls_cancelled, 1u);
}

TEST_F(Streams, ConcurrentRequestsGetTheirOwnAnswers) {
  std::vector<std::thread> threads;
  for (int t = 0; t < 8; ++t) {
    threads.emplace_back([&, t] {
      const double size = 1.0 + t % 3;
      for (int i = 0; i < 5; ++i) {
        const Answer answer = client_->compute({header(1, tetrahedron(size)), points({0.1, 0.2, 0.3})});
        ASSERT_EQ(answer.code, kOk) << answer.message;
        EXPECT_NEAR(numbers<double>(answer.rows.at(0).values()).at(3), 0.3 / size, 1e-11);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_TRUE(eventually([&] { return counters().calls_ok == 40u; }));
}

TEST_F(Streams, ReportsProgress) {
  auto head = header(1000);
  head.mutable_header()->mutable_options()->set_samples(300);
  const Answer answer = client_->compute({head, points(inner_points(1000))});
  ASSERT_EQ(answer.code, kOk) << answer.message;
  EXPECT_GE(answer.progress_count, 1);
}

}  // namespace
}  // namespace barycast::server
