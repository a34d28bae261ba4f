// Rows in closed form, and the promise of linear precision over cages, positions, presets.

#include <gtest/gtest.h>

#include "support/rows.h"

namespace barycast {
namespace {

using testing::Shape;

Options with(Preset preset, uint32_t samples, bool gradients = true) {
  Options options;
  options.preset = preset;
  options.estimator = Estimator::kSampling;
  options.samples = samples;
  options.gradients = gradients;
  return options;
}

TEST(Rows, AreAffineInASimplex) {
  const auto index = testing::make_index(testing::tetrahedron());
  const auto points = testing::random_points(50, 3, -0.5, 1.5, 1);
  for (const CoordinateKind kind :
       {CoordinateKind::kHarmonic, CoordinateKind::kMeanValue, CoordinateKind::kPositiveMeanValue})
    for (const Preset preset : {Preset::kDefault, Preset::kPaper}) {
      Options options = with(preset, 50);
      options.coordinates = kind;
      const RowBlock rows = testing::bind_or_die(index, testing::loose_points(points), options);
      ASSERT_EQ(rows.row_count(), 50u);
      for (size_t i = 0; i < 50; ++i) {
        const auto row = testing::dense_row(rows, i, 4);
        const double* x = points.data() + 3 * i;
        for (size_t k = 0; k < 3; ++k) EXPECT_NEAR(row[k + 1], x[k], 1e-12);
        EXPECT_NEAR(row[0], 1 - x[0] - x[1] - x[2], 1e-12);
        for (uint32_t e = rows.offsets[i]; e < rows.offsets[i + 1]; ++e)
          for (size_t k = 0; k < 3; ++k) {
            const uint32_t v = rows.indices[e];
            EXPECT_NEAR(rows.gradients[3 * e + k], v == 0 ? -1.0 : v == k + 1 ? 1.0 : 0.0, 1e-11);
          }
      }
    }
}

TEST(Rows, AreTrilinearInABox) {
  const auto index = testing::make_index(testing::box());
  const auto points = testing::random_points(40, 3, -0.9, 0.9, 2);
  const RowBlock rows = testing::bind_or_die(index, testing::loose_points(points), with(Preset::kDefault, 20000));
  double squared = 0.0, gradient_squared = 0.0, reference_squared = 0.0;
  for (size_t i = 0; i < 40; ++i) {
    const double* x = points.data() + 3 * i;
    const auto row = testing::dense_row(rows, i, 8);
    for (size_t v = 0; v < 8; ++v) {
      const double s[3] = {(v & 4) != 0 ? 1.0 : -1.0, (v & 2) != 0 ? 1.0 : -1.0, (v & 1) != 0 ? 1.0 : -1.0};
      const double expected = (1 + s[0] * x[0]) * (1 + s[1] * x[1]) * (1 + s[2] * x[2]) / 8;
      squared += (row[v] - expected) * (row[v] - expected);
    }
    for (uint32_t e = rows.offsets[i]; e < rows.offsets[i + 1]; ++e) {
      const uint32_t v = rows.indices[e];
      const double s[3] = {(v & 4) != 0 ? 1.0 : -1.0, (v & 2) != 0 ? 1.0 : -1.0, (v & 1) != 0 ? 1.0 : -1.0};
      for (size_t k = 0; k < 3; ++k) {
        const double expected =
            s[k] / 8 * (1 + s[(k + 1) % 3] * x[(k + 1) % 3]) * (1 + s[(k + 2) % 3] * x[(k + 2) % 3]);
        gradient_squared += std::pow(rows.gradients[3 * e + k] - expected, 2);
        reference_squared += expected * expected;
      }
    }
  }
  EXPECT_LT(std::sqrt(squared / 40), 0.002);  // measured 0.0009
  // The gradient of a linear fit is a regression, not the gradient: near the centre they agree, towards
  // the walls they part. Measured 0.25 of the reference's norm; a wrong sign or scale gives 1 and more.
  EXPECT_LT(std::sqrt(gradient_squared / reference_squared), 0.4);
}

TEST(Rows, AreBilinearInASquare) {
  const auto index = testing::make_index(testing::square());
  const auto points = testing::random_points(40, 2, -0.9, 0.9, 3);
  const RowBlock rows = testing::bind_or_die(index, testing::loose_points(points), with(Preset::kDefault, 20000));
  double squared = 0.0;
  for (size_t i = 0; i < 40; ++i) {
    const double x = points[2 * i], y = points[2 * i + 1];
    const double expected[4] = {(1 - x) * (1 - y) / 4, (1 + x) * (1 - y) / 4, (1 + x) * (1 + y) / 4,
                                (1 - x) * (1 + y) / 4};
    const auto row = testing::dense_row(rows, i, 4);
    for (size_t v = 0; v < 4; ++v) squared += (row[v] - expected[v]) * (row[v] - expected[v]);
  }
  EXPECT_LT(std::sqrt(squared / 40), 0.004);  // measured 0.002
}

// Points on elements, at vertices and edges too, within the thickness, and further away.
template <int D>
std::vector<double> telling_points(const Shape& shape) {
  const auto index = testing::make_index(shape);
  const Cage<D>& cage = std::get<std::unique_ptr<const CageStructures<D>>>(index->structures())->cage;
  std::vector<double> points;
  const auto add = [&](const Vec<D>& normalized) {
    const Vec<D> x = cage.frame().to_caller(normalized);
    points.insert(points.end(), x.data(), x.data() + D);
  };
  for (const Element& element : cage.elements()) {
    Vec<D> centre = Vec<D>::Zero();
    for (int k = 0; k < element.corner_count(); ++k) centre += cage.corner(element, k) / element.corner_count();
    const Vec<D> edge = 0.5 * (cage.corner(element, 0) + cage.corner(element, 1));
    add(cage.corner(element, 0));
    add(edge);
    add(0.5 * (centre + edge));
    for (const double distance : {1e-9, 1e-6, 1e-4, 5e-3})
      for (const double side : {-1.0, 1.0})
        add(0.6 * centre + 0.4 * edge + side * distance * Vec<D>::Ones().normalized());
  }
  const auto inside = testing::random_points(20, D, -0.4, 0.4, 4), outside = testing::random_points(10, D, -1, 1, 5);
  for (size_t i = 0; i < 20; ++i) add(Eigen::Map<const Vec<D>>(inside.data() + D * i));
  for (const double reach : {1.0, 10.0, 1e4})
    for (size_t i = 0; i < 10; ++i) add(reach * Eigen::Map<const Vec<D>>(outside.data() + D * i));
  return points;
}

template <int D>
void expect_promise(const Shape& shape, const std::string& name) {
  const auto index = testing::make_index(shape);
  const auto points = telling_points<D>(shape);
  // The points as a strip of triangles, so that denoising mixes all of them.
  QueryInput mesh{.points = points, .face_offsets = {0}, .face_corners = {}};
  for (uint32_t i = 0; i + 2 < points.size() / D; ++i) {
    mesh.face_corners.insert(mesh.face_corners.end(), {i, i + 1, i + 2});
    mesh.face_offsets.push_back(static_cast<uint32_t>(mesh.face_corners.size()));
  }
  for (const auto kind : {CoordinateKind::kHarmonic, CoordinateKind::kMeanValue, CoordinateKind::kPositiveMeanValue})
    for (const Preset preset : {Preset::kDefault, Preset::kPaper})
      for (const Denoise denoise : {Denoise::kNone, Denoise::kMesh})
        for (const uint32_t samples : {3u, 50u}) {
          Options options = with(preset, samples);
          options.coordinates = kind;
          options.denoise = denoise;
          BindingSummary summary;
          const RowBlock rows = testing::bind_or_die(index, mesh, options, &summary);
          const auto error = testing::promise_error<D>(*index, points, rows);
          const std::string what = name + " kind " + std::to_string(int(kind)) + " preset " +
                                   std::to_string(int(preset)) + " denoise " + std::to_string(int(denoise)) + " m " +
                                   std::to_string(samples);
          EXPECT_LE(error.sum, 1) << what;
          EXPECT_LE(error.position, 1) << what;
          EXPECT_LE(error.gradient, 1) << what;
          EXPECT_LE(summary.linear_precision_error_max, 1e-12) << what;
        }
}

TEST(LinearPrecision, HoldsOnEveryCageAndEverywhere) {
  expect_promise<3>(testing::tetrahedron(), "tetrahedron");
  expect_promise<3>(testing::box(), "box");
  expect_promise<3>(testing::bent_prism(), "bent prism");
  expect_promise<3>(testing::mixed_prism(), "mixed prism");
  expect_promise<3>(testing::open_box(), "open box");
  expect_promise<3>(testing::soup(), "soup");
  expect_promise<2>(testing::star_polygon(), "star");
  expect_promise<2>(testing::square(), "square");
}

TEST(LinearPrecision, SurvivesAnOffsetOf1e5AndAFlatCage) {
  const Eigen::Vector3d offset(1e5, -1e5, 1e5);
  expect_promise<3>(testing::bent_prism().mapped([&](const Eigen::VectorXd& x) { return Eigen::VectorXd(x + offset); }),
                    "offset");
  expect_promise<3>(testing::box().mapped([](Eigen::VectorXd x) {
    x[2] *= 1e-3;
    return x;
  }),
                    "flat");
  // As flat as is accepted.
  expect_promise<3>(testing::box().mapped([](Eigen::VectorXd x) {
    x[2] *= 3.1e-4;
    return x;
  }),
                    "flattest");
}

TEST(OnTheCage, RowsAreTheBasis) {
  const auto index = testing::make_index(testing::bent_prism());
  const auto& cage = std::get<std::unique_ptr<const CageStructures<3>>>(index->structures())->cage;
  std::vector<double> points;
  std::vector<std::vector<double>> expected;
  for (const Element& element : cage.elements()) {
    // u = 0.35, v = 0.55
    const std::array<double, 4> bilinear{0.65 * 0.45, 0.35 * 0.45, 0.35 * 0.55, 0.65 * 0.55};
    Vec<3> y = Vec<3>::Zero();
    std::vector<double> row(cage.control_vertex_count(), 0.0);
    for (int k = 0; k < 4; ++k) {
      y += bilinear[static_cast<size_t>(k)] * cage.corner(element, k);
      row[element.node[static_cast<size_t>(k)]] = bilinear[static_cast<size_t>(k)];
    }
    const Vec<3> x = cage.frame().to_caller(y);
    points.insert(points.end(), x.data(), x.data() + 3);
    expected.push_back(row);
  }
  for (const Preset preset : {Preset::kDefault, Preset::kPaper}) {
    const RowBlock rows = testing::bind_or_die(index, testing::loose_points(points), with(preset, 50));
    for (size_t i = 0; i < expected.size(); ++i) {
      EXPECT_TRUE(rows.flags[i] & kRowOnCage);
      const auto row = testing::dense_row(rows, i, cage.control_vertex_count());
      for (size_t v = 0; v < row.size(); ++v) EXPECT_NEAR(row[v], expected[i][v], 1e-12);
    }
  }
}

// The border of a hole that runs the way of the outline: what is between the two is still inside.
TEST(OnTheCage, FramesComeFromTheInsideOfAHole) {
  Shape frame = testing::square();
  frame.vertices.insert(frame.vertices.end(), {-0.5, -0.5, 0.5, -0.5, 0.5, 0.5, -0.5, 0.5});
  frame.segments.insert(frame.segments.end(), {4, 5, 5, 6, 6, 7, 7, 4});
  const RowBlock rows =
      testing::bind_or_die(testing::make_index(frame), testing::loose_points({0.1, 0.5}), with(Preset::kDefault, 50));
  double outline = 0.0;  // gradients of the outer square's vertices
  for (uint32_t e = 0; e < rows.offsets[1]; ++e)
    if (rows.indices[e] < 4) outline += std::abs(rows.gradients[2 * e + 1]);
  EXPECT_GT(outline, 0.1);
}

TEST(Rows, SayWhatTheyAre) {
  const auto index = testing::make_index(testing::box());
  const RowBlock rows =
      testing::bind_or_die(index, testing::loose_points({0, 0, 0, 1, 0, 0, 3, 0, 0}), with(Preset::kDefault, 50));
  EXPECT_EQ(rows.flags[0], 0);
  EXPECT_EQ(rows.flags[1], kRowOnCage);
  EXPECT_EQ(rows.flags[2], kRowOutside);
  const RowBlock few = testing::bind_or_die(index, testing::loose_points({0, 0, 0}), with(Preset::kDefault, 5));
  EXPECT_EQ(few.flags[0], kRowFewSamples);
  Options hopeless = with(Preset::kPaper, 50);
  hopeless.walk_steps_max = 1;
  BindingSummary summary;
  // Off the centre, where one jump ends at a wall hardly ever.
  const RowBlock none = testing::bind_or_die(index, testing::loose_points({0.3, 0.2, 0.1}), hopeless, &summary);
  EXPECT_EQ(none.flags[0], kRowFewSamples | kRowNoSamples | kRowRankDeficient);
  EXPECT_EQ(summary.walks_discarded, 50u);
  const auto affine = testing::dense_row(none, 0, 8);  // least squares over the corners
  for (size_t v = 0; v < 8; ++v)
    EXPECT_NEAR(affine[v],
                (1 + ((v & 4) != 0 ? 0.3 : -0.3) + ((v & 2) != 0 ? 0.2 : -0.2) + ((v & 1) != 0 ? 0.1 : -0.1)) / 8,
                1e-12);
}

TEST(Rows, KeepWhatSpansSpace) {
  constexpr uint64_t kSeeds = 8;  // a few rows far out, whose walks all ended close together, are most of the change
  const auto index = testing::make_index(testing::sphere(10, 1.0));
  const auto points = testing::random_points(200, 3, -0.57, 0.57, 9);
  double squared = 0.0;
  for (uint64_t seed = 0; seed < kSeeds; ++seed) {
    Options options = with(Preset::kDefault, 50, false);
    options.seed = seed;
    const RowBlock pruned = testing::bind_or_die(index, testing::loose_points(points), options);
    options.prune_below = 0.0;
    const RowBlock all = testing::bind_or_die(index, testing::loose_points(points), options);
    EXPECT_LT(pruned.indices.size(), all.indices.size());
    EXPECT_EQ(all.indices.size(), 200u * index->control_vertex_count());
    for (size_t i = 0; i < 200; ++i) {
      const auto a = testing::dense_row(pruned, i, index->control_vertex_count()),
                 b = testing::dense_row(all, i, index->control_vertex_count());
      for (size_t v = 0; v < a.size(); ++v) squared += (a[v] - b[v]) * (a[v] - b[v]);
      EXPECT_GE(pruned.offsets[i + 1] - pruned.offsets[i], 4u);
    }
  }
  EXPECT_LT(std::sqrt(squared / (200 * kSeeds)), 2e-3);
}

// The largest coordinates stay, rows reproduce position and gradient all the same, down to d + 1 entries.
TEST(Rows, KeepTheLargestInfluencesThatSpanSpace) {
  for (const Shape& shape : {testing::box(), testing::bent_prism(), testing::mixed_prism(), testing::soup()}) {
    const auto index = testing::make_index(shape);
    auto points = testing::random_points(60, 3, -2.0, 2.0, 7);
    points.insert(points.end(), shape.vertices.begin(), shape.vertices.begin() + 12);  // on the cage
    Options options = with(Preset::kDefault, 50);
    const RowBlock all = testing::bind_or_die(index, testing::loose_points(points), options);
    for (const uint32_t most : {4u, 5u, 7u}) {
      options.influences_max = most;
      const RowBlock rows = testing::bind_or_die(index, testing::loose_points(points), options);
      EXPECT_LE(testing::promise_error<3>(*index, points, rows).worst(), 1.0);
      for (size_t i = 0; i < rows.row_count(); ++i) {
        const uint32_t full = all.offsets[i + 1] - all.offsets[i];
        ASSERT_EQ(rows.offsets[i + 1] - rows.offsets[i], std::min(most, full)) << i;
        // The largest one is always among the kept.
        const auto begin = all.values.begin() + all.offsets[i], end = all.values.begin() + all.offsets[i + 1];
        const auto largest = std::max_element(begin, end, [](double a, double b) { return std::abs(a) < std::abs(b); });
        const uint32_t vertex = all.indices[static_cast<size_t>(largest - all.values.begin())];
        const auto kept_begin = rows.indices.begin() + rows.offsets[i];
        EXPECT_TRUE(std::find(kept_begin, rows.indices.begin() + rows.offsets[i + 1], vertex) !=
                    rows.indices.begin() + rows.offsets[i + 1]);
      }
    }
  }
}

TEST(Rows, RefuseFewerInfluencesThanSpanSpace) {
  const auto index = testing::make_index(testing::box());
  Options options;
  options.influences_max = 3;
  const auto refused = bind_all(index, testing::loose_points({0, 0, 0}), *resolve(options, false));
  ASSERT_FALSE(refused.ok());
  EXPECT_EQ(refused.error().field, "influences_max");
}

}  // namespace
}  // namespace barycast
