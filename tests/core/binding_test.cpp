// The entry: options, bad queries, cancellation.

#include <gtest/gtest.h>

#include <malloc.h>
#include <atomic>
#include <future>
#include <thread>

#include <chrono>
#include <limits>
#include <thread>

#include "bind/cost.h"
#include "solve/prediction.h"
#include "support/rows.h"

namespace barycast {
namespace {

TEST(Options, FollowThePresetUnlessSet) {
  Options options;
  const auto standard = resolve(options, true);
  ASSERT_TRUE(standard.ok());
  EXPECT_EQ(standard->estimator, Estimator::kPredicted);
  EXPECT_EQ(standard->samples, 12u);
  EXPECT_EQ(standard->walk_steps_max, 300u);
  EXPECT_EQ(standard->prune_below, 1e-4);
  EXPECT_EQ(standard->denoise, Denoise::kMesh);
  EXPECT_EQ(resolve(options, false)->denoise, Denoise::kNone);
  options.preset = Preset::kPaper;
  const auto paper = resolve(options, true);
  EXPECT_EQ(paper->estimator, Estimator::kSampling);
  EXPECT_EQ(paper->samples, 50u);
  EXPECT_EQ(paper->walk_steps_max, 20u);
  EXPECT_EQ(paper->prune_below, 0.0);
  options.walk_steps_max = 300;
  EXPECT_EQ(resolve(options, true)->walk_steps_max, 300u);
}

// What is not asked for gives way where the cage does not allow it; what is asked for is refused there.
TEST(Options, SettleForSamplesWhereTheCageIsTooLarge) {
  const ResolvedOptions unset = *resolve({}, true), given = *resolve({.samples = 7}, true),
                        chosen = *resolve({.estimator = Estimator::kPredicted}, true);
  constexpr uint64_t kTriangles = HarmonicPrediction::kTrianglesMost, kVertices = HarmonicPrediction::kVerticesMost;
  EXPECT_EQ(settle(unset, 3, kVertices, kTriangles).estimator, Estimator::kPredicted);
  for (const ResolvedOptions& large :
       {settle(unset, 3, kVertices, kTriangles + 1), settle(unset, 3, kVertices + 1, kTriangles)}) {
    EXPECT_EQ(large.estimator, Estimator::kSampling);
    EXPECT_EQ(large.samples, 50u);
    EXPECT_TRUE(large.unpredicted);
    EXPECT_EQ(settle(large, 3, kVertices, kTriangles).samples, 50u);  // again changes nothing
  }
  EXPECT_EQ(settle(unset, 2, 8, 0).estimator, Estimator::kSampling);
  EXPECT_FALSE(settle(unset, 2, 8, 0).unpredicted);
  EXPECT_EQ(settle(given, 3, kVertices + 1, kTriangles).samples, 7u);
  EXPECT_EQ(settle(chosen, 3, kVertices + 1, kTriangles).estimator, Estimator::kPredicted);
}

TEST(CageIndex, SaysThatItsCageIsTooLargeToBePredicted) {
  const auto index = testing::make_index(testing::sphere(12, 1.0));
  ASSERT_GT(index->surface_triangles(), HarmonicPrediction::kTrianglesMost);
  BindingSummary summary;
  const QueryInput points = testing::loose_points({0, 0, 0, 0.2, 0.1, 0});
  testing::bind_or_die(index, points, {}, &summary);
  ASSERT_EQ(summary.warnings.size(), 1u);
  EXPECT_EQ(summary.warnings[0].field, "estimator");
  EXPECT_EQ(summary.samples, 100u);
  const auto refused = bind_all(index, points, *resolve({.estimator = Estimator::kPredicted}, false));
  ASSERT_FALSE(refused.ok());
  EXPECT_EQ(refused.error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(refused.error().field, "estimator");
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
}

struct Thing {
  size_t bytes() const { return 7; }
};

TEST(Lazy, BuildsOnceForAllWhoAsk) {
  Lazy<Thing> lazy;
  std::atomic<int> builds = 0, answers = 0;
  std::promise<void> go_on;
  std::thread first([&] {
    lazy.prepare(
        [&]() -> Result<std::unique_ptr<const Thing>> {
          ++builds;
          go_on.get_future().wait();
          return std::make_unique<const Thing>();
        },
        [&](const Status& status) { answers += status.ok(); });
  });
  while (builds == 0) std::this_thread::yield();
  const auto never = [&]() -> Result<std::unique_ptr<const Thing>> {
    ++builds;
    return std::make_unique<const Thing>();
  };
  for (int i = 0; i < 5; ++i) lazy.prepare(never, [&](const Status& status) { answers += status.ok(); });
  EXPECT_EQ(answers, 0);  // and nobody waited
  EXPECT_EQ(lazy.bytes(), 0u);
  go_on.set_value();
  first.join();
  EXPECT_EQ(answers, 6);
  lazy.prepare(never, [&](const Status& status) { answers += status.ok(); });
  EXPECT_EQ(answers, 7);
  EXPECT_EQ(builds, 1);
  EXPECT_EQ(lazy.bytes(), 7u);
}

TEST(Lazy, AFailureReachesAllAndIsTriedAgain) {
  Lazy<Thing> lazy;
  ErrorCode code{};
  const auto keep = [&](const Status& status) { code = status.error().code; };
  lazy.prepare([]() -> Result<std::unique_ptr<const Thing>> { throw std::bad_alloc(); }, keep);
  EXPECT_EQ(code, ErrorCode::kResourceExhausted);
  lazy.prepare([]() -> Result<std::unique_ptr<const Thing>> { return Error{ErrorCode::kInternal, "", "no"}; }, keep);
  EXPECT_EQ(code, ErrorCode::kInternal);
  bool built = false;
  lazy.prepare([]() -> Result<std::unique_ptr<const Thing>> { return std::make_unique<const Thing>(); },
               [&](const Status& status) { built = status.ok(); });
  EXPECT_TRUE(built);
}

// Each kind of coordinates has its structures, and what another kind built changes no bit.
TEST(CageIndex, BuildsWhatAKindAsksFor) {
  const testing::Shape shape = testing::sphere(6, 1.0);
  const auto harmonic = *resolve({.estimator = Estimator::kSampling}, false),
             mean_value = *resolve({.coordinates = CoordinateKind::kMeanValue}, false);
  const auto index = *CageIndex::create(shape.input());
  const size_t empty = index->bytes();
  const QueryInput points = testing::loose_points(testing::random_points(50, 3, -1.2, 1.2, 1));
  const RowBlock rays_alone = *bind_all(index, points, mean_value);
  const size_t with_rays = index->bytes();
  EXPECT_GT(with_rays, empty);
  std::vector<std::thread> threads;
  for (int i = 0; i < 8; ++i) threads.emplace_back([&] { EXPECT_TRUE(index->prepare(harmonic).ok()); });
  for (std::thread& thread : threads) thread.join();
  const size_t with_both = index->bytes();
  EXPECT_GT(with_both, with_rays);
  const RowBlock rays_again = *bind_all(index, points, mean_value), walks = *bind_all(index, points, harmonic);
  EXPECT_EQ(index->bytes(), with_both);
  EXPECT_EQ(rays_again.values, rays_alone.values);
  EXPECT_EQ(walks.values, bind_all(*CageIndex::create(shape.input()), points, harmonic)->values);
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

// Work of seconds and minutes, stopped: at one point with very many samples, at many points, while smoothing.
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
  many.samples = 1'000'000;  // ten times what a server allows
  // The promise is 50 ms; a shared machine under a sanitizer gets a second.
  EXPECT_LT(stopped_after(testing::loose_points({0.5, 0.5, 0.5}), many, Stage::kSampling), 1.0);
  EXPECT_LT(stopped_after(testing::loose_points(testing::random_points(100000, 3, 0, 1, 1)), {}, Stage::kSampling),
            1.0);
  Options few;
  few.samples = 1;
  EXPECT_LT(stopped_after(testing::mesh_of(testing::sphere(60, 0.5)), few, Stage::kSmoothing), 1.0);
}

// Memory of this process that is in use, without what malloc keeps for later.
uint64_t bytes_in_use() {
  const auto info = mallinfo2();
  return info.uordblks + info.hblkhd;
}

// The most that a binding holds between two pieces of work, against the bound that admits it.
void expect_estimate_holds(const testing::Shape& cage, const QueryInput& queries, const Options& options) {
#if defined(__SANITIZE_ADDRESS__)
  GTEST_SKIP() << "the sanitizer's allocator does not say what is in use";
#endif
  const auto index = testing::make_index(cage);
  const auto resolved = *resolve(options, !queries.face_offsets.empty());
  const BindingSize size{.dimension = 3,
                         .control_vertices = index->control_vertex_count(),
                         .stencil_max = index->stencil_max(),
                         .points = queries.points.size() / 3,
                         .faces = queries.face_offsets.size(),
                         .face_corners = queries.face_corners.size(),
                         .threads = 2};
  const uint64_t before = bytes_in_use();
  auto binding = Binding::create(index, queries, {.options = resolved});
  ASSERT_TRUE(binding.ok());
  uint64_t peak = 0;
  for (Binding::Step step = Binding::Step::kWorking; step != Binding::Step::kDone;) {
    step = (*binding)->advance(kNeverCancelled);
    if (step == Binding::Step::kBlock) (*binding)->take_block();
    peak = std::max(peak, bytes_in_use() - before);
  }
  EXPECT_LE(peak, bound_memory_bytes(size, resolved));
  EXPECT_GE(4 * peak, bound_memory_bytes(size, resolved)) << "a bound this far off refuses what would fit";
}

TEST(Memory, EstimateHoldsForLoosePoints) {
  Options options;
  options.samples = 1;
  expect_estimate_holds(testing::box(), testing::loose_points(testing::random_points(200000, 3, -0.9, 0.9, 1)),
                        options);
}

TEST(Memory, EstimateHoldsWithDenoising) {
  Options options;
  options.samples = 20;
  options.gradients = true;
  expect_estimate_holds(testing::sphere(8, 1.0), testing::mesh_of(testing::sphere(60, 0.8)), options);
}

TEST(Memory, EstimateHoldsForLargePolygons) {
  // A drum: two polygons of 300 corners.
  testing::Shape drum;
  drum.polygon_offsets = {0, 300, 600};
  for (uint32_t i = 0; i < 600; ++i) {
    const double angle = 2 * std::numbers::pi * i / 300;
    drum.vertices.insert(drum.vertices.end(), {std::cos(angle), std::sin(angle), i < 300 ? 0.0 : 1.0});
    drum.polygon_corners.push_back(i);
    if (i < 300) drum.quads.insert(drum.quads.end(), {i, (i + 1) % 300, 300 + (i + 1) % 300, 300 + i});
  }
  Options options;
  options.samples = 5;
  expect_estimate_holds(drum, testing::mesh_of(testing::sphere(30, 0.3)), options);
}

}  // namespace
}  // namespace barycast
