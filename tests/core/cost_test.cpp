// The cost model against what a binding really allocates: every byte that malloc hands out is counted, so
// the peak is exact. A program of its own, since it replaces malloc.

#include "bind/cost.h"

#include <gtest/gtest.h>

#include <cmath>

#include "counted_malloc.h"
#include "support/mean_value.h"
#include "support/rows.h"

namespace barycast {
namespace {

using testing::Shape;

// A wavy sheet of side x side points in the middle of the unit sphere.
QueryInput sheet(uint32_t side, bool triangles) {
  Shape shape;
  for (uint32_t i = 0; i < side; ++i)
    for (uint32_t j = 0; j < side; ++j) {
      const double x = -0.5 + 1.0 * i / (side - 1), y = -0.5 + 1.0 * j / (side - 1);
      shape.vertices.insert(shape.vertices.end(), {x, y, 0.3 * std::sin(5 * x) * std::cos(4 * y)});
    }
  for (uint32_t i = 0; i + 1 < side; ++i)
    for (uint32_t j = 0; j + 1 < side; ++j) {
      const uint32_t a = i * side + j, b = a + 1, c = a + side + 1, d = a + side;
      if (triangles) {
        shape.triangles.insert(shape.triangles.end(), {a, b, c, a, c, d});
      } else {
        shape.quads.insert(shape.quads.end(), {a, b, c, d});
      }
    }
  return testing::mesh_of(shape);
}

QueryInput loose(uint32_t count) {
  return testing::loose_points(testing::random_points(count, 3, -0.55, 0.55, 1));
}

QueryInput ball(int n) {
  return testing::mesh_of(testing::sphere(n, 0.8));
}

Options choices(uint32_t samples, bool gradients, double prune_below) {
  Options options;
  options.estimator = Estimator::kSampling;
  options.samples = samples;
  options.gradients = gradients;
  options.prune_below = prune_below;
  return options;
}

BindingSize size_of(const CageIndex& index, const QueryInput& queries) {
  return {.dimension = 3,
          .control_vertices = index.control_vertex_count(),
          .stencil_max = index.stencil_max(),
          .elements = index.element_count(),
          .triangles = index.surface_triangles(),
          .closed = index.is_closed(),
          .points = queries.points.size() / 3,
          .faces = queries.face_offsets.empty() ? 0 : queries.face_offsets.size() - 1,
          .face_corners = queries.face_corners.size(),
          .threads = 2};
}

struct Measured {
  uint64_t peak = 0, entries = 0, samples = 0;
};

// From the query input, which counts, to the end.
Measured measure(const std::shared_ptr<const CageIndex>& index, const QueryInput& queries,
                 const ResolvedOptions& options) {
  const uint64_t before = testing::bytes_in_use();
  testing::reset_bytes_in_use_max();
  auto binding = Binding::create(index, queries, {.options = options});
  EXPECT_TRUE(binding.ok());
  for (Binding::Step step = Binding::Step::kWorking; step != Binding::Step::kDone;) {
    step = (*binding)->advance(kNeverCancelled);
    if (step == Binding::Step::kBlock) (*binding)->take_block();
  }
  const BindingSummary& summary = (*binding)->summary();
  return {testing::bytes_in_use_max() - before, summary.entries, summary.samples};
}

Options paper(uint32_t samples) {
  Options options;
  options.preset = Preset::kPaper;
  options.samples = samples;
  return options;
}

Options rays(CoordinateKind kind, uint32_t samples) {
  Options options = choices(samples, true, 1e-4);
  options.coordinates = kind;
  return options;
}

// Spheres inside one another: a ray has as many hits as there are layers.
Shape nested(int layers) {
  Shape all;
  for (int i = 0; i < layers; ++i) {
    const Shape one = testing::triangulated(testing::sphere(4, 1.0 - 0.5 * i / layers));
    const auto first = static_cast<uint32_t>(all.vertex_count());
    all.vertices.insert(all.vertices.end(), one.vertices.begin(), one.vertices.end());
    for (const uint32_t v : one.triangles) all.triangles.push_back(first + v);
  }
  return all;
}

Options limited(uint32_t influences_max) {
  Options options = choices(50, true, 1e-4);
  options.influences_max = influences_max;
  return options;
}

Options solved(Estimator estimator, uint32_t panels) {
  Options options;
  options.estimator = estimator;
  if (panels > 0) options.panels = panels;
  if (estimator == Estimator::kExact) options.coordinates = CoordinateKind::kMeanValue;
  options.gradients = true;
  return options;
}

Options predicted(bool gradients) {
  Options options;
  options.estimator = Estimator::kPredicted;
  options.gradients = gradients;
  return options;
}

struct Case {
  const char* name;
  Shape cage;
  QueryInput queries;
  Options options;
};

std::vector<Case> cases() {
  const auto vertices = [](int n) { return testing::sphere(n, 1.0); };  // 14, 26, 62, 114, 146 for 3, 4, 6, 8, 9
  return {
      {"1k loose, box", testing::box(), loose(1000), choices(50, false, 1e-4)},
      {"1k loose, 146, all entries", vertices(9), loose(1000), choices(500, true, 0)},
      {"10k loose, 114, gradients", vertices(8), loose(10'000), choices(50, true, 1e-4)},
      {"10k loose, 114, all entries", vertices(8), loose(10'000), choices(20, false, 0)},
      {"300k loose, box", testing::box(), loose(300'000), choices(1, false, 1e-4)},
      {"1k ball, box", testing::box(), ball(22), choices(20, false, 1e-4)},
      {"1k ball, 26", vertices(4), ball(22), choices(500, false, 1e-4)},
      {"1k ball, 62", vertices(6), ball(22), choices(50, true, 0)},
      {"1k ball, 146", vertices(9), ball(22), choices(50, true, 1e-4)},
      {"7k ball, 14", vertices(3), ball(60), choices(20, true, 1e-4)},
      {"7k ball, 146", vertices(9), ball(60), choices(20, false, 1e-4)},
      {"10k quads, 114", vertices(8), sheet(100, false), choices(20, false, 1e-4)},
      {"10k triangles, 26", vertices(4), sheet(100, true), choices(50, false, 1e-4)},
      {"1k loose, 62, paper", vertices(6), loose(1000), paper(50)},
      {"3k ball, 62, paper", vertices(6), ball(40), paper(50)},
      {"3k ball, 114, 8 influences", vertices(8), ball(40), limited(8)},
      {"10k loose, 114, mean value", vertices(8), loose(10'000), rays(CoordinateKind::kMeanValue, 50)},
      {"3k ball, 62, mean value", vertices(6), ball(40), rays(CoordinateKind::kMeanValue, 20)},
      {"3k ball, 114, positive", vertices(8), ball(40), rays(CoordinateKind::kPositiveMeanValue, 50)},
      {"10k quads, 26, mean value", vertices(4), sheet(100, false), rays(CoordinateKind::kMeanValue, 500)},
      {"1k loose, 62, 300 panels", vertices(6), loose(1000), solved(Estimator::kBoundaryElement, 300)},
      {"1k loose, open, 500 panels", testing::open_box(), loose(1000), solved(Estimator::kBoundaryElement, 500)},
      {"10k loose, box, 1000 panels", testing::box(), loose(10'000), solved(Estimator::kBoundaryElement, 1000)},
      {"10k loose, 62, exact", testing::triangulated(vertices(6)), loose(10'000), solved(Estimator::kExact, 0)},
      {"10k loose, 62, predicted", vertices(6), loose(10'000), predicted(true)},
      {"100k loose, open, predicted", testing::open_box(), loose(100'000), predicted(false)},
      {"3k ball, 114, predicted", vertices(8), ball(40), predicted(true)},
      {"14k ball, 146, predicted", vertices(9), ball(85), predicted(false)},
      {"40k triangles, box, predicted", testing::box(), sheet(200, true), predicted(true)},
      {"40k triangles, box", testing::box(), sheet(200, true), choices(20, true, 0)},
  };
}

TEST(Cost, EstimateIsWithinAQuarterOfThePeak) {
  for (const Case& c : cases()) {
    const auto index = testing::make_index(c.cage);
    const auto options = *resolve(c.options, !c.queries.face_offsets.empty());
    const Measured measured = measure(index, c.queries, options);
    const BindingSize size = size_of(*index, c.queries);
    const auto peak = static_cast<double>(measured.peak);
    const double ratio = static_cast<double>(estimate_memory_bytes(size, options)) / peak;
    const double bound = static_cast<double>(bound_memory_bytes(size, options)) / peak;
    std::printf("%-30s peak %8.2f MB, estimate %.2f, bound %.2f of it; entries %.2f\n", c.name, peak / 1e6, ratio,
                bound, static_cast<double>(estimate_entries(size, options)) / static_cast<double>(measured.entries));
    EXPECT_NEAR(ratio, 1.0, 0.25) << c.name;
    EXPECT_GE(bound, 1.0) << c.name << ": admission would let memory run out";
    EXPECT_LE(bound, 2.5) << c.name << ": admission would refuse what fits";
    EXPECT_NEAR(static_cast<double>(estimate_entries(size, options)) / static_cast<double>(measured.entries), 1.0, 0.3)
        << c.name;
    EXPECT_EQ(estimate_samples(size, options), measured.samples) << c.name;
  }
}

// The fits of the points under way, which nothing else grows with: few points, many control vertices, short rows.
TEST(Cost, BoundHoldsForFewPointsOfManyVertices) {
  for (const int n : {16, 32})
    for (const uint32_t samples : {50u, 500u})
      for (const auto kind : {CoordinateKind::kHarmonic, CoordinateKind::kPositiveMeanValue}) {
        const auto index = testing::make_index(testing::sphere(n, 1.0));
        Options choice = choices(samples, false, 1e-4);
        choice.influences_max = 4;
        choice.coordinates = kind;
        const auto options = *resolve(choice, false);
        const QueryInput queries = loose(256);
        EXPECT_GE(bound_memory_bytes(size_of(*index, queries), options), measure(index, queries, options).peak)
            << n << " " << samples;
      }
}

// Nothing but the noise decides how many rounds there are: here all of them, of the tasks of both threads.
TEST(Cost, BoundHoldsForAllRoundsToATargetError) {
  for (const int n : {4, 8}) {
    const auto index = testing::make_index(testing::sphere(n, 1.0));
    Options choice = predicted(true);
    choice.target_error = 1e-5;
    const auto options = *resolve(choice, false);
    const QueryInput queries = loose(64);
    const BindingSize size = size_of(*index, queries);
    const Measured measured = measure(index, queries, options);
    EXPECT_EQ(estimate_samples(size, options), 64u * 12u * 512u);
    EXPECT_EQ(measured.samples, 64u * 12u * 512u);
    EXPECT_GE(bound_memory_bytes(size, options), measured.peak) << n;
  }
}

// What it adds for tables, most of which are yet to be made, is what they add. Those that are kept are the index's.
TEST(Cost, BoundHoldsForTables) {
  for (const Shape& cage : {testing::box(), testing::sphere(8, 1.0), testing::bent_prism()}) {
    const auto index = testing::make_index(cage);
    Options choice = predicted(false);
    const auto without = *resolve(choice, false);
    choice.tables = true;
    const auto with = *resolve(choice, false);
    ASSERT_TRUE(index->prepare(with).ok());
    const QueryInput queries = loose(200);
    const BindingSize size = size_of(*index, queries);
    measure(index, queries, without);  // of points outside there is a prediction then
    const Measured walked = measure(index, queries, without);
    const size_t before = index->bytes();
    const Measured measured = measure(index, queries, with);
    const uint64_t kept = index->bytes() - before;
    const uint64_t more = bound_memory_bytes(size, with) - bound_memory_bytes(size, without);
    std::printf("tables: %.2f MB more, bound %.2f MB\n",
                (static_cast<double>(measured.peak) - static_cast<double>(kept + walked.peak)) / 1e6,
                static_cast<double>(more) / 1e6);
    EXPECT_GT(index->table_count(), 0u);
    EXPECT_LE(measured.samples, estimate_samples(size, with));
    EXPECT_GE(walked.peak + kept + more, measured.peak);
  }
}

// Few points, of which some may be outside: what the cage's predictions take is nearly all.
TEST(Cost, BoundHoldsForPredictionsOfBothSides) {
  for (const Shape& cage : {testing::sphere(8, 1.0), testing::open_box()})
    for (const double size : {0.5, 2.0}) {
      const auto index = testing::make_index(cage);
      const auto options = *resolve(predicted(true), false);
      const QueryInput queries = testing::loose_points(testing::random_points(300, 3, -size, size, 1));
      EXPECT_GE(bound_memory_bytes(size_of(*index, queries), options), measure(index, queries, options).peak) << size;
    }
}

// However many hits a ray has, memory stays below the bound; only the estimate cannot know.
TEST(Cost, BoundHoldsForRaysThroughManyLayers) {
  const auto index = testing::make_index(nested(20));
  const QueryInput queries = testing::mesh_of(testing::sphere(30, 0.4));
  for (const auto kind : {CoordinateKind::kMeanValue, CoordinateKind::kPositiveMeanValue}) {
    const auto options = *resolve(rays(kind, 2), true);
    EXPECT_GE(bound_memory_bytes(size_of(*index, queries), options), measure(index, queries, options).peak);
  }
}

// Sizes are known and the estimate is a function of them: more is never less.
TEST(Cost, GrowsWithTheRequest) {
  const auto options = *resolve(choices(50, false, 1e-4), true);
  uint64_t before = 0;
  for (uint64_t points = 1000; points <= 100'000'000; points *= 10) {
    const BindingSize size{.control_vertices = 100, .points = points, .faces = points, .face_corners = 4 * points};
    EXPECT_GT(estimate_memory_bytes(size, options), before);
    EXPECT_GT(bound_memory_bytes(size, options), estimate_memory_bytes(size, options));
    before = estimate_memory_bytes(size, options);
  }
}

TEST(Cost, RaysComeInLinesOfTwo) {
  ResolvedOptions options = *resolve(choices(51, false, 1e-4), false);
  EXPECT_EQ(estimate_samples({.points = 10}, options), 510u);
  options.coordinates = CoordinateKind::kMeanValue;
  EXPECT_EQ(estimate_samples({.points = 10}, options), 520u);
  options.preset = Preset::kPaper;
  EXPECT_EQ(estimate_samples({.points = 10}, options), 510u);
}

}  // namespace
}  // namespace barycast
