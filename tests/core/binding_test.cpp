// The entry: options, bad queries, cancellation.

#include <gtest/gtest.h>

#include <chrono>
#include <limits>
#include <thread>

#include "support/rows.h"

namespace barycast {
namespace {

TEST(Options, FollowThePresetUnlessSet) {
  Options options;
  const auto standard = resolve(options, true);
  ASSERT_TRUE(standard.ok());
  EXPECT_EQ(standard->samples, 50u);
  EXPECT_EQ(standard->walk_steps_max, 300u);
  EXPECT_EQ(standard->prune_below, 1e-4);
  EXPECT_EQ(standard->denoise, Denoise::kMesh);
  EXPECT_EQ(resolve(options, false)->denoise, Denoise::kNone);
  options.preset = Preset::kPaper;
  const auto paper = resolve(options, true);
  EXPECT_EQ(paper->walk_steps_max, 20u);
  EXPECT_EQ(paper->prune_below, 0.0);
  options.walk_steps_max = 300;
  EXPECT_EQ(resolve(options, true)->walk_steps_max, 300u);
}

TEST(Options, AreRefusedByName) {
  const auto refused = [](auto change) {
    Options options;
    change(options);
    const auto resolved = resolve(options, false);
    return resolved.ok() ? std::string() : resolved.error().field;
  };
  EXPECT_EQ(refused([](Options& o) { o.samples = 0; }), "samples");
  EXPECT_EQ(refused([](Options& o) { o.samples = 2'000'000'000; }), "samples");
  EXPECT_EQ(refused([](Options& o) { o.thickness = 0.0; }), "thickness");
  EXPECT_EQ(refused([](Options& o) { o.thickness = std::numeric_limits<double>::quiet_NaN(); }), "thickness");
  EXPECT_EQ(refused([](Options& o) { o.walk_steps_max = 0; }), "walk_steps_max");
  EXPECT_EQ(refused([](Options& o) { o.prune_below = -1; }), "prune_below");
  EXPECT_EQ(refused([](Options& o) { o.smoothing_time = -1; }), "smoothing_time");
  EXPECT_EQ(refused([](Options& o) { o.denoise = Denoise::kMesh; }), "denoise");
  EXPECT_EQ(refused([](Options& o) { o.coordinates = CoordinateKind::kMeanValue; }), "coordinates");
}

TEST(Queries, AreRefusedByName) {
  const auto index = testing::make_index(testing::box());
  const auto refused = [&](QueryInput queries) {
    const auto rows = bind_all(index, std::move(queries), *resolve({}, false));
    return rows.ok() ? std::string() : rows.error().field;
  };
  EXPECT_EQ(refused({}), "points");
  EXPECT_EQ(refused(testing::loose_points({0, 0})), "points");
  EXPECT_EQ(refused(testing::loose_points({0, 0, 0, 0, std::numeric_limits<double>::infinity(), 0})), "points[1]");
  EXPECT_EQ(refused(testing::loose_points({1e12, 0, 0})), "points[0]");
  QueryInput mesh{.points = {0, 0, 0, 0.1, 0, 0, 0, 0.1, 0}, .face_offsets = {0, 3}, .face_corners = {0, 1, 3}};
  EXPECT_EQ(refused(mesh), "faces[0].corner[2]");
  mesh.face_offsets = {0, 2, 3};
  EXPECT_EQ(refused(mesh), "faces[0]");
  mesh.face_offsets = {0, 4};
  EXPECT_EQ(refused(mesh), "faces");
}

TEST(Queries, WarnOfRepeatedPoints) {
  BindingSummary summary;
  testing::bind_or_die(testing::make_index(testing::box()), testing::loose_points({0, 0, 0, 0.1, 0, 0, -0.0, 0, 0}), {},
                       &summary);
  ASSERT_EQ(summary.warnings.size(), 1u);
  EXPECT_EQ(summary.warnings[0].field, "points");
}

// Work of minutes, stopped: at one point with very many samples, at many points, while smoothing.
TEST(Cancellation, StopsEveryStage) {
  const auto index = testing::make_index(testing::bent_prism());
  const auto stopped_after = [&](const QueryInput& queries, const Options& options, Stage wanted) {
    auto binding = Binding::create(index, queries, {.options = *resolve(options, !queries.face_offsets.empty())});
    EXPECT_TRUE(binding.ok());
    std::atomic<bool> cancel = false;
    std::chrono::steady_clock::time_point asked;
    std::atomic<bool> reached = false;
    std::thread canceller([&] {
      while (!reached) std::this_thread::yield();
      asked = std::chrono::steady_clock::now();
      cancel = true;
    });
    Binding::Step step;
    do {
      if ((*binding)->progress().stage == wanted) reached = true;
      step = (*binding)->advance(cancel);
      if (step == Binding::Step::kBlock) (*binding)->take_block();
    } while (step == Binding::Step::kWorking || step == Binding::Step::kBlock);
    reached = true;
    canceller.join();
    EXPECT_EQ(step, Binding::Step::kCancelled);
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - asked).count();
  };
  Options many;
  many.samples = 10'000'000;
  // The promise is 50 ms; a shared machine under a sanitizer gets a second.
  EXPECT_LT(stopped_after(testing::loose_points({0.5, 0.5, 0.5}), many, Stage::kSampling), 1.0);
  EXPECT_LT(stopped_after(testing::loose_points(testing::random_points(100000, 3, 0, 1, 1)), {}, Stage::kSampling),
            1.0);
  Options few;
  few.samples = 1;
  EXPECT_LT(stopped_after(testing::mesh_of(testing::sphere(60, 0.5)), few, Stage::kSmoothing), 1.0);
}

TEST(Memory, EstimateBoundsTheObvious) {
  const auto options = *resolve({}, true);
  EXPECT_GT(estimate_memory_bytes(3, 100, 1'000'000, 4'000'000, options), 1'000'000u * 24u);
  EXPECT_LT(estimate_memory_bytes(3, 100, 40'000, 240'000, options), uint64_t{1} << 30);
}

}  // namespace
}  // namespace barycast
