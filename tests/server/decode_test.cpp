// Headers of ComputeCoordinates: every refusal names its field and has the right code.

#include "decode.h"

#include <gtest/gtest.h>

#include <cstring>
#include <functional>
#include <limits>
#include <set>

#include "encode.h"
#include "messages.h"

namespace barycast::server {
namespace {

using namespace testing;

const Limits kLimits{.points_max = 1000, .faces_max = 500, .samples_max = 100, .block_rows_max = 64};

v1::ComputeHeader sound() {
  return header(10).header();
}

void expect_refused(const v1::ComputeHeader& header, ErrorCode code, const std::string& field) {
  const Result<ComputePlan> plan = decode_header(header, kLimits);
  ASSERT_FALSE(plan.ok()) << field;
  EXPECT_EQ(plan.error().code, code) << plan.error().text();
  EXPECT_EQ(plan.error().field, field) << plan.error().text();
  EXPECT_FALSE(plan.error().message.empty());
}

constexpr ErrorCode kInvalid = ErrorCode::kInvalidArgument;

TEST(DecodeHeader, AcceptsASoundOne) {
  v1::ComputeHeader h = sound();
  h.mutable_options()->set_samples(100);
  h.mutable_output()->set_gradients(true);
  const Result<ComputePlan> plan = decode_header(h, kLimits);
  ASSERT_TRUE(plan.ok()) << plan.error().text();
  EXPECT_TRUE(plan->cage.has_value());
  EXPECT_FALSE(plan->digest.has_value());
  EXPECT_EQ(plan->counts.points, 10u);
  EXPECT_EQ(plan->options.samples, 100u);
  EXPECT_TRUE(plan->options.gradients);
  EXPECT_TRUE(plan->float64);
}

TEST(DecodeHeader, KnowsEveryEstimator) {
  const std::vector<std::pair<v1::Estimator, Estimator>> pairs = {
      {v1::ESTIMATOR_UNSPECIFIED, Estimator::kPredicted},
      {v1::ESTIMATOR_SAMPLING, Estimator::kSampling},
      {v1::ESTIMATOR_BOUNDARY_ELEMENT, Estimator::kBoundaryElement},
      {v1::ESTIMATOR_EXACT, Estimator::kExact},
      {v1::ESTIMATOR_PREDICTED, Estimator::kPredicted},
  };
  EXPECT_EQ(static_cast<int>(pairs.size()), v1::Estimator_ARRAYSIZE);
  for (const auto& [sent, meant] : pairs) {
    v1::ComputeHeader h = sound();
    h.mutable_options()->set_estimator(sent);
    if (sent == v1::ESTIMATOR_EXACT) h.mutable_options()->set_coordinates(v1::COORDINATE_KIND_MEAN_VALUE);
    const Result<ComputePlan> plan = decode_header(h, kLimits);
    ASSERT_TRUE(plan.ok()) << plan.error().text();
    EXPECT_EQ(plan->options.estimator, meant);
  }
}

// The response says what was decided: what the estimator uses and nothing else.
TEST(EncodeHeader, CarriesWhatTheEstimatorUses) {
  for (const v1::Estimator estimator :
       {v1::ESTIMATOR_SAMPLING, v1::ESTIMATOR_BOUNDARY_ELEMENT, v1::ESTIMATOR_PREDICTED}) {
    v1::ComputeHeader h = sound();
    h.mutable_options()->set_estimator(estimator);
    const v1::ComputeCoordinatesResponse answer = encode_header({.digest = {},
                                                                 .cage_cache_hit = false,
                                                                 .options = decode_header(h, kLimits)->options,
                                                                 .smoothing_time = 0.25,
                                                                 .float64 = true,
                                                                 .block_rows = 10,
                                                                 .control_vertex_count = 4});
    const v1::ComputeOptions& said = answer.header().options();
    EXPECT_EQ(said.estimator(), estimator);
    const bool sampled = estimator != v1::ESTIMATOR_BOUNDARY_ELEMENT;
    EXPECT_EQ(said.has_panels(), !sampled);
    EXPECT_EQ(said.has_samples(), sampled);
    EXPECT_EQ(said.has_thickness(), sampled);
    EXPECT_EQ(said.has_walk_steps_max(), sampled);
    EXPECT_EQ(said.has_smoothing_time(), sampled);
    EXPECT_EQ(said.samples(), estimator == v1::ESTIMATOR_SAMPLING ? 50u : sampled ? 12u : 0u);
  }
}

TEST(Capabilities, ListEveryEstimator) {
  const v1::GetCapabilitiesResponse answer = encode_capabilities(kLimits, "");
  EXPECT_EQ(std::set<int>(answer.estimators().begin(), answer.estimators().end()), (std::set<int>{1, 2, 3, 4}));
}

TEST(DecodeHeader, RefusesToPredict) {
  const auto asks = [] {
    v1::ComputeHeader h = sound();
    h.mutable_options()->set_estimator(v1::ESTIMATOR_PREDICTED);
    return h;
  };
  v1::ComputeHeader h = asks();
  h.mutable_options()->set_preset(v1::PRESET_PAPER);
  expect_refused(h, kInvalid, "header.options.estimator");
  h = asks();
  h.mutable_options()->set_coordinates(v1::COORDINATE_KIND_MEAN_VALUE);
  expect_refused(h, kInvalid, "header.options.estimator");
  h = asks();
  h.mutable_options()->set_panels(100);
  expect_refused(h, kInvalid, "header.options.panels");
  h = asks();
  h.mutable_options()->set_samples(101);
  expect_refused(h, kInvalid, "header.options.samples");
}

v1::ComputeHeader asks_for_target(double target) {
  v1::ComputeHeader h = sound();
  h.mutable_options()->set_target_error(target);
  h.mutable_output()->set_errors(true);
  return h;
}

TEST(DecodeHeader, TakesATargetErrorInsteadOfSamples) {
  v1::ComputeHeader h = asks_for_target(2e-3);
  h.mutable_queries()->set_face_count(1);
  h.mutable_queries()->set_corner_count(3);
  const Result<ComputePlan> plan = decode_header(h, {});
  ASSERT_TRUE(plan.ok()) << plan.error().text();
  EXPECT_EQ(plan->options.estimator, Estimator::kPredicted);
  EXPECT_EQ(plan->options.target_error, 2e-3);
  EXPECT_EQ(plan->options.denoise, Denoise::kNone);
  EXPECT_TRUE(plan->errors);
  h.mutable_output()->set_errors(false);
  EXPECT_FALSE(decode_header(h, {})->errors);
}

TEST(DecodeHeader, RefusesATargetErrorWhereItMakesNoSense) {
  const auto field = [](const std::function<void(v1::ComputeHeader&)>& spoil, const Limits& limits = {}) {
    v1::ComputeHeader h = asks_for_target(2e-3);
    spoil(h);
    const Result<ComputePlan> plan = decode_header(h, limits);
    return plan.ok() ? "" : plan.error().field;
  };
  EXPECT_EQ(field([](auto& h) { h.mutable_options()->set_samples(12); }), "header.options.samples");
  EXPECT_EQ(field([](auto& h) { h.mutable_options()->set_denoise(v1::DENOISE_MESH); }), "header.options.denoise");
  EXPECT_EQ(field([](auto& h) { h.mutable_options()->set_smoothing_time(0.0); }), "header.options.denoise");
  const std::string path = "header.options.target_error";
  EXPECT_EQ(field([](auto& h) { h.mutable_options()->set_estimator(v1::ESTIMATOR_SAMPLING); }), path);
  EXPECT_EQ(field([](auto& h) { h.mutable_options()->set_preset(v1::PRESET_PAPER); }), path);
  EXPECT_EQ(field([](auto& h) { h.mutable_options()->set_coordinates(v1::COORDINATE_KIND_MEAN_VALUE); }), path);
  for (const double bad : {0.0, -1e-3, 1e-6, 2.0, std::numeric_limits<double>::quiet_NaN()})
    EXPECT_EQ(field([&](auto& h) { h.mutable_options()->set_target_error(bad); }), path) << bad;
  EXPECT_EQ(field([](auto& h) { h.mutable_options()->clear_target_error(); }), "header.output.errors");
  // As many samples a point as all rounds have are too many, or just not.
  EXPECT_EQ(field([](auto&) {}, Limits{.samples_max = 6143}), path);
  EXPECT_EQ(field([](auto&) {}, Limits{.samples_max = 6144}), "");
}

// What the answer's header says may be asked for again.
TEST(EncodeHeader, ATargetErrorGoesRound) {
  v1::ComputeHeader h = asks_for_target(2e-3);
  const v1::ComputeCoordinatesResponse answer = encode_header({.digest = {},
                                                               .options = decode_header(h, {})->options,
                                                               .float64 = true,
                                                               .errors = true,
                                                               .block_rows = 10,
                                                               .control_vertex_count = 4});
  const v1::ComputeOptions& said = answer.header().options();
  EXPECT_EQ(said.target_error(), 2e-3);
  EXPECT_EQ(said.denoise(), v1::DENOISE_NONE);
  EXPECT_FALSE(said.has_samples());
  EXPECT_FALSE(said.has_smoothing_time());
  EXPECT_TRUE(answer.header().output().errors());
  *h.mutable_options() = said;
  *h.mutable_output() = answer.header().output();
  const Result<ComputePlan> again = decode_header(h, {});
  ASSERT_TRUE(again.ok()) << again.error().text();
  EXPECT_EQ(again->options.target_error, 2e-3);
}

TEST(DecodeHeader, TakesTablesWithPredictionsOnly) {
  v1::ComputeHeader h = sound();
  h.mutable_queries()->set_face_count(1);
  h.mutable_queries()->set_corner_count(3);
  EXPECT_FALSE(decode_header(h, {})->options.tables);
  h.mutable_options()->set_tables(true);
  const Result<ComputePlan> plan = decode_header(h, {});
  ASSERT_TRUE(plan.ok()) << plan.error().text();
  EXPECT_TRUE(plan->options.tables);
  EXPECT_EQ(plan->options.estimator, Estimator::kPredicted);
  EXPECT_EQ(plan->options.denoise, Denoise::kNone);
  h.mutable_options()->set_denoise(v1::DENOISE_MESH);
  EXPECT_EQ(decode_header(h, {})->options.denoise, Denoise::kMesh);

  const auto refused = [](const std::function<void(v1::ComputeOptions&)>& spoil) {
    v1::ComputeHeader spoilt = sound();
    spoilt.mutable_options()->set_tables(true);
    spoil(*spoilt.mutable_options());
    expect_refused(spoilt, kInvalid, "header.options.tables");
  };
  refused([](auto& o) { o.set_estimator(v1::ESTIMATOR_SAMPLING); });
  refused([](auto& o) { o.set_estimator(v1::ESTIMATOR_BOUNDARY_ELEMENT); });
  refused([](auto& o) { o.set_preset(v1::PRESET_PAPER); });
  refused([](auto& o) { o.set_coordinates(v1::COORDINATE_KIND_MEAN_VALUE); });
}

// What the answer's header says may be asked for again, with a target error as well.
TEST(EncodeHeader, TablesGoRound) {
  v1::ComputeHeader h = sound();
  h.mutable_options()->set_tables(true);
  const v1::ComputeCoordinatesResponse answer = encode_header({.digest = {},
                                                               .options = decode_header(h, {})->options,
                                                               .float64 = true,
                                                               .block_rows = 10,
                                                               .control_vertex_count = 4});
  *h.mutable_options() = answer.header().options();
  EXPECT_TRUE(h.options().tables());
  const Result<ComputePlan> again = decode_header(h, {});
  ASSERT_TRUE(again.ok()) << again.error().text();
  EXPECT_TRUE(again->options.tables);
  // Of their noise errors would know nothing.
  v1::ComputeHeader targeted = sound();
  targeted.mutable_options()->set_tables(true);
  targeted.mutable_options()->set_target_error(2e-3);
  expect_refused(targeted, kInvalid, "header.options.tables");
}

TEST(EncodeRows, CarryErrorsWhereAskedFor) {
  const RowBlock block{.offsets = {0, 1, 2},
                       .indices = {0, 1},
                       .values = {1.0, 1.0},
                       .gradients = {},
                       .flags = {0, 0},
                       .errors = {1e-3f, 2e-3f, 0.0f, 0.5f}};
  EXPECT_TRUE(encode_rows(block, {}).rows().errors().empty());
  const std::string bytes = encode_rows(block, {.errors = true}).rows().errors();
  ASSERT_EQ(bytes.size(), 4 * sizeof(float));
  std::vector<float> sent(4);
  std::memcpy(sent.data(), bytes.data(), bytes.size());
  EXPECT_EQ(sent, block.errors);
}

TEST(DecodeHeader, DefaultsToFloat32) {
  v1::ComputeHeader h = sound();
  h.clear_output();
  EXPECT_FALSE(decode_header(h, kLimits)->float64);
}

TEST(DecodeHeader, RefusesCounts) {
  v1::ComputeHeader h = sound();
  h.mutable_queries()->set_point_count(0);
  expect_refused(h, kInvalid, "header.queries.point_count");
  h.clear_queries();
  expect_refused(h, kInvalid, "header.queries.point_count");
  h.mutable_queries()->set_point_count(1001);
  expect_refused(h, kInvalid, "header.queries.point_count");
  h.mutable_queries()->set_point_count(std::numeric_limits<uint64_t>::max());
  expect_refused(h, kInvalid, "header.queries.point_count");
  h.mutable_queries()->set_point_count(10);
  h.mutable_queries()->set_face_count(501);
  expect_refused(h, kInvalid, "header.queries.face_count");
  h.mutable_queries()->set_face_count(2);
  h.mutable_queries()->set_corner_count(5);
  expect_refused(h, kInvalid, "header.queries.corner_count");
  h.mutable_queries()->set_corner_count(uint64_t{1} << 33);
  expect_refused(h, kInvalid, "header.queries.corner_count");
  h.mutable_queries()->set_face_count(0);
  h.mutable_queries()->set_corner_count(3);
  expect_refused(h, kInvalid, "header.queries.corner_count");
}

TEST(DecodeHeader, RefusesOptions) {
  v1::ComputeHeader h = sound();
  h.mutable_options()->set_samples(0);
  expect_refused(h, kInvalid, "header.options.samples");
  h.mutable_options()->set_samples(101);
  expect_refused(h, kInvalid, "header.options.samples");
  h.mutable_options()->clear_samples();
  h.mutable_options()->set_coordinates(static_cast<v1::CoordinateKind>(77));
  expect_refused(h, kInvalid, "header.options.coordinates");
  h.mutable_options()->clear_coordinates();
  h.mutable_options()->set_preset(static_cast<v1::Preset>(77));
  expect_refused(h, kInvalid, "header.options.preset");
  h.mutable_options()->clear_preset();
  h.mutable_options()->set_denoise(static_cast<v1::Denoise>(-1));
  expect_refused(h, kInvalid, "header.options.denoise");
  h.mutable_options()->set_denoise(v1::DENOISE_MESH);
  expect_refused(h, kInvalid, "header.options.denoise");
  h.mutable_options()->clear_denoise();
  for (const double bad : {0.0, -1e-3, 1.0, std::numeric_limits<double>::quiet_NaN()}) {
    h.mutable_options()->set_thickness(bad);
    expect_refused(h, kInvalid, "header.options.thickness");
  }
  h.mutable_options()->clear_thickness();
  h.mutable_options()->set_walk_steps_max(0);
  expect_refused(h, kInvalid, "header.options.walk_steps_max");
  h.mutable_options()->clear_walk_steps_max();
  h.mutable_options()->set_prune_below(0.5);
  expect_refused(h, kInvalid, "header.options.prune_below");
}

TEST(DecodeHeader, RefusesOutput) {
  v1::ComputeHeader h = sound();
  h.mutable_output()->set_type(v1::DATA_TYPE_UINT32);
  expect_refused(h, kInvalid, "header.output.type");
  h.mutable_output()->set_type(static_cast<v1::DataType>(9));
  expect_refused(h, kInvalid, "header.output.type");
  h.mutable_output()->clear_type();
  h.mutable_output()->set_block_rows(65);
  expect_refused(h, kInvalid, "header.output.block_rows");
}

TEST(DecodeHeader, RefusesDigestsAndResume) {
  v1::ComputeHeader h = sound();
  h.clear_cage();
  expect_refused(h, kInvalid, "header");
  h.mutable_cage_digest()->set_sha256(std::string(31, 'x'));
  h.mutable_cage_digest()->set_size_bytes(100);
  expect_refused(h, kInvalid, "header.cage_digest.sha256");
  h.mutable_cage_digest()->set_sha256(std::string(32, 'x'));
  EXPECT_TRUE(decode_header(h, kLimits).ok());
  h.mutable_cage_digest()->set_size_bytes(0);
  expect_refused(h, kInvalid, "header.cage_digest.size_bytes");
  h.mutable_cage_digest()->set_size_bytes(100);
  *h.mutable_expected_digest() = h.cage_digest();
  h.mutable_expected_digest()->set_size_bytes(101);
  expect_refused(h, kInvalid, "header.expected_digest");

  h = sound();
  h.mutable_resume()->set_first_row(10);
  h.mutable_resume()->set_numerics_version(kNumericsVersion);
  expect_refused(h, kInvalid, "header.resume.first_row");
  h.mutable_resume()->set_first_row(9);
  EXPECT_EQ(decode_header(h, kLimits)->first_row, 9u);
  h.mutable_resume()->set_numerics_version(kNumericsVersion + 1);
  expect_refused(h, ErrorCode::kFailedPrecondition, "header.resume.numerics_version");
}

TEST(DecodeDigests, RefusesTooManyAndTruncated) {
  v1::FindMissingCagesRequest request;
  for (int i = 0; i < 3; ++i) {
    request.add_digests()->set_sha256(std::string(32, static_cast<char>(i)));
    request.mutable_digests(i)->set_size_bytes(100);
  }
  EXPECT_EQ(decode_digests(request, Limits{.digests_max = 3})->size(), 3u);
  EXPECT_EQ(decode_digests(request, Limits{.digests_max = 2}).error().field, "digests");
  request.mutable_digests(2)->set_sha256("short");
  EXPECT_EQ(decode_digests(request, kLimits).error().field, "digests[2].sha256");
}

}  // namespace
}  // namespace barycast::server
