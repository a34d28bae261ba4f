// What leaves the client in blocks, what it accepts from a server, and when it tries again.

#include <gtest/gtest.h>

#include <numeric>

#include "messages.h"
#include "request_blocks.h"
#include "retry.h"
#include "shapes.h"

namespace barycast::client::testing {
namespace {

using std::chrono::milliseconds;

TEST(Blocks, FacesStayWholeAndWithinTheLimit) {
  Faces faces;
  std::vector<uint32_t> large(5000);
  std::iota(large.begin(), large.end(), 0u);
  for (uint32_t i = 0; i < 3000; ++i) faces.add(std::vector<uint32_t>{i, i + 1, i + 2});
  faces.add(large);  // more than a message may hold: sent alone, for the server to refuse
  faces.add(std::vector<uint32_t>{0, 1, 2});
  Faces seen;
  int messages = 0;
  EXPECT_TRUE(send_faces(faces, 16384, [&](const v1::ComputeCoordinatesRequest& message) {
    const auto* counts = reinterpret_cast<const uint32_t*>(message.faces().corner_counts().data().data());
    const auto* corners = reinterpret_cast<const uint32_t*>(message.faces().corners().data().data());
    for (uint64_t i = 0; i < message.faces().corner_counts().rows(); ++i) {
      seen.add(std::span(corners, counts[i]));
      corners += counts[i];
    }
    EXPECT_TRUE(message.ByteSizeLong() <= 16384 || message.faces().corner_counts().rows() == 1);
    ++messages;
    return true;
  }));
  EXPECT_EQ(seen.offsets, faces.offsets);
  EXPECT_EQ(seen.corners, faces.corners);
  EXPECT_EQ(messages, 6);
  EXPECT_FALSE(send_faces(faces, 16384, [&](const auto&) { return false; }));
}

TEST(Blocks, PointsOfBothTypes) {
  const std::vector<float> floats(3 * 1000, 0.5f);
  std::vector<uint64_t> rows;
  const auto send = [&](const v1::ComputeCoordinatesRequest& message) {
    rows.push_back(message.points().points().rows());
    EXPECT_EQ(message.points().points().type(), v1::DATA_TYPE_FLOAT32);
    return true;
  };
  EXPECT_TRUE(send_points({std::span<const float>(floats), 3}, 4096 + 12 * 400, send));
  EXPECT_EQ(rows, (std::vector<uint64_t>{400, 400, 200}));
  rows.clear();
  EXPECT_TRUE(send_points({std::span<const float>(floats), 3}, 1024, send));  // smaller than its own overhead
  EXPECT_EQ(rows.size(), 1000u);
}

class Rows : public ::testing::Test {
 protected:
  void SetUp() override {
    header_.set_control_vertex_count(8);
    header_.mutable_output()->set_type(v1::DATA_TYPE_FLOAT32);
    set_array(*block_.mutable_offsets(), std::vector<uint32_t>{0, 1, 3});
    set_array(*block_.mutable_indices(), std::vector<uint32_t>{7, 0, 1});
    set_array(*block_.mutable_values(), std::vector<float>{1, 0.5f, 0.5f}, 1);
    block_.set_flags(std::string(2, '\0'));
  }
  bool accepted() const { return from_message(block_, header_, 3).ok(); }

  v1::ResponseHeader header_;
  v1::RowBlock block_;
};

TEST_F(Rows, ThatFitTogetherAreAccepted) {
  ASSERT_TRUE(accepted());
  EXPECT_EQ(from_message(block_, header_, 3)->indices, (std::vector<uint32_t>{7, 0, 1}));
}

TEST_F(Rows, ThatDoNotAreRefused) {
  const v1::RowBlock good = block_;
  const auto refuses = [&](const std::function<void()>& change) {
    block_ = good;
    change();
    return !accepted();
  };
  EXPECT_TRUE(refuses([&] { set_array(*block_.mutable_indices(), std::vector<uint32_t>{8, 0, 1}); }));
  EXPECT_TRUE(refuses([&] { set_array(*block_.mutable_offsets(), std::vector<uint32_t>{0, 4, 3}); }));
  EXPECT_TRUE(refuses([&] { set_array(*block_.mutable_offsets(), std::vector<uint32_t>{1, 1, 3}); }));
  EXPECT_TRUE(refuses([&] { set_array(*block_.mutable_offsets(), std::vector<uint32_t>{0, 1, 2}); }));
  EXPECT_TRUE(refuses([&] { block_.set_flags(std::string(3, '\0')); }));
  EXPECT_TRUE(refuses([&] { block_.mutable_values()->set_type(v1::DATA_TYPE_FLOAT64); }));
  EXPECT_TRUE(refuses([&] { block_.mutable_values()->mutable_data()->pop_back(); }));
  EXPECT_TRUE(refuses([&] { block_.mutable_values()->set_rows(uint64_t{1} << 62); }));
  EXPECT_TRUE(refuses([&] { block_.mutable_indices()->set_rows(uint64_t{1} << 62); }));
  EXPECT_TRUE(refuses([&] { block_.mutable_indices()->set_columns(0); }));
  EXPECT_TRUE(refuses([&] { block_.clear_offsets(); }));
  EXPECT_TRUE(refuses([&] { block_.set_errors(std::string(16, '\0')); }));  // not asked for
  header_.mutable_output()->set_gradients(true);
  EXPECT_TRUE(refuses([] {}));
  header_.mutable_output()->set_gradients(false);
  header_.mutable_output()->set_errors(true);
  EXPECT_TRUE(refuses([] {}));
  EXPECT_TRUE(refuses([&] { block_.set_errors(std::string(17, '\0')); }));
  EXPECT_FALSE(refuses([&] { block_.set_errors(std::string(16, '\0')); }));
}

Failure failure(Code code) {
  return {.error = {.code = code, .message = "x"}};
}

TEST(Retry, OnlyWhereWaitingHelps) {
  Retry retry(milliseconds(60'000), milliseconds(0), {});
  for (const Code code : {Code::kInvalidArgument, Code::kInternal, Code::kDeadlineExceeded, Code::kResourceExhausted}) {
    EXPECT_FALSE(retry.wait(failure(code)));
  }
  EXPECT_TRUE(retry.wait(failure(Code::kUnavailable)));
  Failure busy = failure(Code::kResourceExhausted);
  busy.retry_after = milliseconds(50);
  const auto start = Retry::Clock::now();
  EXPECT_TRUE(retry.wait(busy));
  EXPECT_GE(Retry::Clock::now() - start, milliseconds(50));
}

TEST(Retry, EndsWithItsTime) {
  Failure busy = failure(Code::kResourceExhausted);
  busy.retry_after = milliseconds(1000);
  EXPECT_FALSE(Retry(milliseconds(500), milliseconds(0), {}).wait(busy));
  EXPECT_FALSE(Retry(milliseconds(60'000), milliseconds(500), {}).wait(busy));
  EXPECT_FALSE(Retry(milliseconds(0), milliseconds(0), {}).wait(busy));
  Retry retry(milliseconds(700), milliseconds(0), {});
  const auto start = Retry::Clock::now();
  int waits = 0;
  while (retry.wait(failure(Code::kUnavailable)) && waits < 10'000) ++waits;
  EXPECT_GE(waits, 1);
  EXPECT_LE(Retry::Clock::now() - start, milliseconds(2000));
}

TEST(Retry, AStopEndsItsSleep) {
  std::stop_source source;
  source.request_stop();
  Failure busy = failure(Code::kResourceExhausted);
  busy.retry_after = milliseconds(20'000);
  const auto start = Retry::Clock::now();
  EXPECT_FALSE(Retry(milliseconds(60'000), milliseconds(0), source.get_token()).wait(busy));
  EXPECT_LE(Retry::Clock::now() - start, milliseconds(5000));
}

}  // namespace
}  // namespace barycast::client::testing
