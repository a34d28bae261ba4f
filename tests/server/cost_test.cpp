// EstimateCost: it refuses what ComputeCoordinates refuses, in the same words, and its numbers are those of
// the answer. What the memory model is worth is tests/core/cost_test.cpp.

#include <cmath>
#include <functional>

#include "decode.h"
#include "estimate/error_estimate.h"
#include "fixture.h"

namespace barycast::server {
namespace {

using namespace testing;

class EstimateCost : public ServerTest {
 protected:
  void SetUp() override { start(settings()); }
  static DaemonSettings settings() {
    DaemonSettings settings;
    settings.limits.cage_bytes_max = 2000;
    settings.limits.points_max = 100'000'000;
    settings.limits.samples_max = 1000;
    settings.limits.request_bytes_max = 16 << 20;
    return settings;
  }

  // The estimate's answer to the fields of a header.
  Outcome estimate(const v1::ComputeHeader& header, v1::EstimateCostResponse& response,
                   const CallSettings& settings = {}) {
    v1::EstimateCostRequest request;
    if (header.has_inline_cage()) *request.mutable_inline_cage() = header.inline_cage();
    if (header.has_cage_digest()) *request.mutable_cage_digest() = header.cage_digest();
    *request.mutable_queries() = header.queries();
    *request.mutable_options() = header.options();
    *request.mutable_output() = header.output();
    return client_->estimate(request, response, settings);
  }
};

using Spoil = std::function<void(v1::ComputeHeader&)>;

v1::CageDigest digest_of(const v1::Cage& cage) {
  const CageDigest digest = barycast::digest(decode_cage(cage, {})->input());
  v1::CageDigest result;
  result.set_sha256(digest.sha256.data(), digest.sha256.size());
  result.set_size_bytes(digest.size_bytes);
  return result;
}

const std::vector<Spoil> kSpoils = {
    [](auto& h) { h.mutable_queries()->set_point_count(0); },
    [](auto& h) { h.mutable_queries()->set_point_count(200'000'000); },
    [](auto& h) { h.mutable_queries()->set_point_count(1'000'000); },  // over the memory of one request
    [](auto& h) { h.mutable_queries()->set_face_count(3); },
    [](auto& h) { h.mutable_queries()->set_corner_count(9); },
    [](auto& h) { h.mutable_options()->set_samples(0); },
    [](auto& h) { h.mutable_options()->set_samples(1001); },
    [](auto& h) { h.mutable_options()->set_preset(static_cast<v1::Preset>(12)); },
    [](auto& h) { h.mutable_options()->set_coordinates(static_cast<v1::CoordinateKind>(99)); },
    [](auto& h) { h.mutable_options()->set_denoise(v1::DENOISE_MESH); },
    [](auto& h) { h.mutable_options()->set_denoise(static_cast<v1::Denoise>(9)); },
    [](auto& h) { h.mutable_options()->set_thickness(1.0); },
    [](auto& h) { h.mutable_options()->set_walk_steps_max(0); },
    [](auto& h) { h.mutable_options()->set_prune_below(std::nan("")); },
    [](auto& h) { h.mutable_options()->set_smoothing_time(-1); },
    [](auto& h) { h.mutable_options()->set_target_error(1e-3); },  // more samples than this server takes
    [](auto& h) { h.mutable_options()->set_target_error(2.0); },
    [](auto& h) { h.mutable_output()->set_errors(true); },
    [](auto& h) {
      h.mutable_options()->set_tables(true);
      h.mutable_options()->set_estimator(v1::ESTIMATOR_SAMPLING);
    },
    [](auto& h) { h.mutable_output()->set_type(v1::DATA_TYPE_UINT32); },
    [](auto& h) { h.mutable_output()->set_block_rows(10'000'000); },
    [](auto& h) { h.mutable_output()->set_influences_max(3); },
    [](auto& h) { h.clear_cage(); },
    [](auto& h) { h.mutable_cage_digest()->set_sha256("short"); },
    [](auto& h) { *h.mutable_cage_digest() = digest_of(tetrahedron(7)); },  // unknown
    [](auto& h) { h.mutable_inline_cage()->clear_control_vertices(); },
    [](auto& h) { h.mutable_inline_cage()->clear_triangles(); },
    [](auto& h) {
      *h.mutable_inline_cage()->mutable_triangles() = indices(3, {0, 1, 2, 0, 1, 57});
    },
    [](auto& h) {
      *h.mutable_inline_cage()->mutable_triangles() = indices(3, {0, 0, 0, 1, 1, 2});
    },
    [](auto& h) { *h.mutable_inline_cage()->mutable_triangles() = indices(3, std::vector<uint32_t>(600, 1)); },
    [](auto& h) { *h.mutable_inline_cage()->mutable_points() = indices(1, {0}); },
    [](auto& h) { h.mutable_inline_cage()->mutable_triangles()->mutable_data()->resize(47); },
    [](auto& h) {
      *h.mutable_inline_cage()->mutable_control_vertices() = doubles(3, {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0});
    },
};

TEST_F(EstimateCost, RefusesWhatWouldBeRefused) {
  for (size_t i = 0; i < kSpoils.size(); ++i) {
    auto request = header(1);
    kSpoils[i](*request.mutable_header());
    const Answer computed = client_->compute({request, points({0.1, 0.2, 0.3})});
    v1::EstimateCostResponse response;
    const Outcome estimated = estimate(request.header(), response);
    EXPECT_NE(computed.code, kOk) << i;
    EXPECT_EQ(estimated.code, computed.code) << i << ": " << estimated.message;
    EXPECT_EQ(estimated.message, computed.message) << i;
    EXPECT_EQ(estimated.details.SerializeAsString(), computed.details.SerializeAsString()) << i;
  }
  const CallSettings wrong = {.metadata = {{"x-cage-digest", std::string(64, '0')}}};
  v1::EstimateCostResponse response;
  EXPECT_EQ(estimate(header(1).header(), response, wrong).message,
            client_->compute({header(1), points({0.1, 0.2, 0.3})}, wrong).message);
}

// Sent along or known to the server, closed or open: one estimate.
TEST_F(EstimateCost, OfAPredictionIsTheSameForAKnownCage) {
  for (const bool closed : {true, false}) {
    v1::Cage cage = tetrahedron();
    if (!closed) *cage.mutable_triangles() = indices(3, {0, 2, 1, 0, 1, 3, 0, 3, 2});
    auto request = header(10, cage);
    request.mutable_header()->mutable_options()->set_estimator(v1::ESTIMATOR_PREDICTED);
    v1::EstimateCostResponse sent, known;
    const Outcome outcome = estimate(request.header(), sent);
    ASSERT_EQ(outcome.code, kOk) << outcome.message;
    const Answer answer = client_->compute({request, points(inner_points(10))});
    ASSERT_EQ(answer.code, kOk) << answer.message;
    EXPECT_EQ(sent.samples(), 120u);
    EXPECT_EQ(answer.summary->samples(), 120u);
    *request.mutable_header()->mutable_cage_digest() = digest_of(cage);
    ASSERT_EQ(estimate(request.header(), known).code, kOk);
    EXPECT_EQ(known.memory_bytes(), sent.memory_bytes());
  }
}

// How many rounds a point takes depends on its noise: the estimate says the most, in samples and in memory.
TEST_F(EstimateCost, OfATargetErrorIsTheMost) {
  DaemonSettings more = settings();
  more.limits.samples_max = 6144;
  start(more);
  auto request = header(100);
  request.mutable_header()->mutable_options()->set_estimator(v1::ESTIMATOR_PREDICTED);
  request.mutable_header()->mutable_output()->set_type(v1::DATA_TYPE_FLOAT64);
  v1::EstimateCostResponse once, most, with_errors;
  ASSERT_EQ(estimate(request.header(), once).code, kOk);
  request.mutable_header()->mutable_options()->set_target_error(1e-5);
  ASSERT_EQ(estimate(request.header(), most).code, kOk);
  EXPECT_EQ(most.samples(), 100u * 12u * 512u);
  EXPECT_GT(most.memory_bytes(), once.memory_bytes() + 32 * Randomizations::kBatchesMost * 4 * sizeof(float));
  request.mutable_header()->mutable_output()->set_errors(true);
  ASSERT_EQ(estimate(request.header(), with_errors).code, kOk);
  EXPECT_EQ(with_errors.output_bytes(), most.output_bytes() + 100 * 8);
  const Answer answer = client_->compute({request, points(inner_points(100))});
  ASSERT_EQ(answer.code, kOk) << answer.message;
  EXPECT_LE(answer.summary->samples(), most.samples());
  ASSERT_EQ(answer.rows.size(), 1u);
  EXPECT_EQ(answer.rows[0].errors().size(), 100u * 8u);
}

// Which points tables serve only the points tell: the estimate says the most.
TEST_F(EstimateCost, WithTablesIsTheMost) {
  auto request = header(100);
  request.mutable_header()->mutable_options()->set_estimator(v1::ESTIMATOR_PREDICTED);
  v1::EstimateCostResponse without, with;
  ASSERT_EQ(estimate(request.header(), without).code, kOk);
  request.mutable_header()->mutable_options()->set_tables(true);
  ASSERT_EQ(estimate(request.header(), with).code, kOk);
  EXPECT_EQ(with.samples(), without.samples());
  EXPECT_GT(with.memory_bytes(), without.memory_bytes());
  const Answer answer = client_->compute({request, points(inner_points(100))});
  ASSERT_EQ(answer.code, kOk) << answer.message;
  EXPECT_LT(answer.summary->samples(), with.samples());
}

TEST_F(EstimateCost, AnUnknownCageIsMissing) {
  auto request = header(1);
  *request.mutable_header()->mutable_cage_digest() = digest_of(tetrahedron());
  v1::EstimateCostResponse response;
  const Outcome unknown = estimate(request.header(), response);
  EXPECT_EQ(unknown.code, kFailedPrecondition);
  EXPECT_FALSE(unknown.missing().empty());
  expect_works();  // brings the cage
  EXPECT_EQ(estimate(request.header(), response).code, kOk);
  EXPECT_GT(response.memory_bytes(), 0u);
}

TEST_F(EstimateCost, DoesNothing) {
  v1::EstimateCostResponse response;
  ASSERT_EQ(estimate(header(1000).header(), response).code, kOk);
  EXPECT_EQ(counters().steps, 0u);
  v1::FindMissingCagesRequest question;
  *question.add_digests() = digest_of(tetrahedron());
  v1::FindMissingCagesResponse reply;
  client_->find_missing(question, reply);
  EXPECT_EQ(reply.missing_size(), 1) << "the cage was built";
}

// A tetrahedron's rows are full, so that the numbers are exact.
TEST_F(EstimateCost, NumbersAreThoseOfTheAnswer) {
  for (const v1::DataType type : {v1::DATA_TYPE_FLOAT32, v1::DATA_TYPE_FLOAT64})
    for (const bool gradients : {false, true}) {
      auto request = header(1000);
      request.mutable_header()->mutable_output()->set_type(type);
      request.mutable_header()->mutable_output()->set_gradients(gradients);
      request.mutable_header()->mutable_output()->set_block_rows(300);
      request.mutable_header()->mutable_options()->set_prune_below(0.0);
      v1::EstimateCostResponse response;
      ASSERT_EQ(estimate(request.header(), response).code, kOk);
      const Answer answer = client_->compute({request, points(inner_points(1000))});
      ASSERT_EQ(answer.code, kOk) << answer.message;
      uint64_t bytes = 0;
      for (const v1::RowBlock& block : answer.rows)
        bytes += block.offsets().data().size() + block.indices().data().size() + block.values().data().size() +
                 block.gradients().data().size() + block.flags().size();
      EXPECT_EQ(response.output_bytes(), bytes);
      EXPECT_EQ(response.samples(), 1000u * 12u);
      EXPECT_EQ(response.samples(), answer.summary->samples());
    }
}

TEST_F(EstimateCost, BeingBusyIsNoRefusal) {
  DaemonSettings one = settings();
  one.admission.requests_max = 1;
  start(one);
  // Seconds of work, which has begun.
  const auto holder = client_->open();
  auto head = header(1000);
  head.mutable_header()->mutable_options()->set_samples(1000);
  holder->write(head);
  holder->write(points(inner_points(1000)));
  holder->half_close();
  ASSERT_TRUE(eventually([&] { return counters().steps > 0; }));
  EXPECT_TRUE(client_->compute({header(1), points({0.1, 0.2, 0.3})}).has_retry());
  v1::EstimateCostResponse response;
  EXPECT_EQ(estimate(header(1).header(), response).code, kOk);
  holder->cancel();
  holder->finish();
}

}  // namespace
}  // namespace barycast::server
