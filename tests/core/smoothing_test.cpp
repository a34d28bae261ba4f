// Denoising: the operator by itself, and what it must not break.

#include <gtest/gtest.h>

#include "smooth/heat.h"
#include "smooth/kernel_cache.h"
#include "smooth/laplacian.h"
#include "smooth/strength.h"
#include "support/mean_value.h"
#include "support/rows.h"

namespace barycast {
namespace {

QueryMesh to_mesh(const QueryInput& input) {
  QueryMesh mesh;
  for (size_t i = 0; i < input.points.size(); i += 3)
    mesh.nodes.push_back(Eigen::Map<const Vec<3>>(input.points.data() + i));
  mesh.face_offsets = input.face_offsets;
  mesh.face_nodes = input.face_corners;
  return mesh;
}

TEST(Laplacian, IsTheCotangentLaplacianOnTriangles) {
  const Vec<3> a(0, 0, 0), b(2, 0.3, 0.1), c(0.5, 1.7, -0.4);
  const QueryMesh mesh{{a, b, c}, {0, 3}, {0, 1, 2}};
  const MeshLaplacian laplacian = *polygon_laplacian(mesh, kNeverCancelled);
  const auto cotangent = [](const Vec<3>& at, const Vec<3>& p, const Vec<3>& q) {
    return (p - at).dot(q - at) / (p - at).cross(q - at).norm();
  };
  EXPECT_NEAR(laplacian.stiffness.coeff(1, 0), -0.5 * cotangent(c, a, b), 1e-12);
  EXPECT_NEAR(laplacian.stiffness.coeff(2, 1), -0.5 * cotangent(a, b, c), 1e-12);
  EXPECT_NEAR(laplacian.stiffness.coeff(2, 0), -0.5 * cotangent(b, a, c), 1e-12);
  EXPECT_NEAR(laplacian.area.sum(), 0.5 * (b - a).cross(c - a).norm(), 1e-12);
}

TEST(Laplacian, AnnihilatesLinearFunctionsInsideFlatMeshes) {
  // Around the one inner node: a hexagon, a quad and two triangles, all in a plane. L x is zero there.
  QueryMesh mesh;
  for (const auto& p : {std::array{0.0, 0.0},
                        {1.0, 0.2},
                        {1.4, 1.1},
                        {0.3, 1.5},
                        {-0.8, 1.2},
                        {-1.1, 0.1},
                        {-0.9, -1.0},
                        {0.2, -1.3},
                        {1.2, -0.8}})
    mesh.nodes.push_back(Vec<3>(p[0], p[1], 0.5 * p[0] - p[1]));
  mesh.face_offsets = {0, 6, 10, 13, 16};
  mesh.face_nodes = {0, 1, 2, 3, 4, 5, 0, 5, 6, 7, 0, 7, 8, 0, 8, 1};
  const MeshLaplacian laplacian = *polygon_laplacian(mesh, kNeverCancelled);
  const Eigen::SparseMatrix<double> whole = laplacian.stiffness.selfadjointView<Eigen::Lower>();
  const Eigen::MatrixXd stiffness = whole;
  for (int axis = 0; axis < 3; ++axis) {
    double sum = 0.0;
    for (int j = 0; j < 9; ++j) sum += stiffness(0, j) * mesh.nodes[static_cast<size_t>(j)][axis];
    EXPECT_NEAR(sum, 0.0, 1e-12);
  }
  for (int i = 0; i < 9; ++i) EXPECT_NEAR(stiffness.row(i).sum(), 0.0, 1e-12);
}

// Solves are in floats; these lose no more than some of their roundings.
constexpr double kRounding = 2e-6;

TEST(Heat, KeepsConstantsAndNodesWithoutArea) {
  const QueryInput sphere = testing::mesh_of(testing::sphere(20, 1.0));
  QueryMesh mesh = to_mesh(sphere);
  mesh.nodes.push_back(Vec<3>(9, 9, 9));  // isolated
  const size_t count = mesh.nodes.size();
  const auto kernel = HeatKernel::create(*polygon_laplacian(mesh, kNeverCancelled), std::vector(count, 0.05));
  ASSERT_TRUE(kernel.ok());
  std::vector<float> block(count * HeatKernel::kColumns);
  const auto at = [&](size_t node, size_t k) -> float& {
    return block[kernel->place(node) * HeatKernel::kColumns + k];
  };
  for (size_t i = 0; i < count; ++i) {
    at(i, 0) = 1.0f;
    at(i, 1) = static_cast<float>(mesh.nodes[i][2]);
  }
  ASSERT_TRUE(kernel->smooth(block, kNeverCancelled));
  for (size_t i = 0; i < count; ++i) EXPECT_NEAR(at(i, 0), 1.0, kRounding);
  // The height on a sphere is an eigenfunction of the Laplacian with eigenvalue 2: it shrinks by 1 / (1 + 2 t).
  EXPECT_NEAR(at(0, 1), 1 / (1 + 2 * 0.05), 0.01);
  EXPECT_EQ(at(count - 1, 1), 9.0f);
  EXPECT_FALSE(kernel->smooths(count - 1));
}

// Every node has its own time: against the dense solution of (A T^-1 + L) x = A T^-1 b.
TEST(Heat, FlowsForEveryNodesOwnTime) {
  const QueryMesh mesh = to_mesh(testing::mesh_of(testing::sphere(8, 1.0)));
  const size_t count = mesh.nodes.size();
  std::vector<double> times(count);
  for (size_t i = 0; i < count; ++i) times[i] = i % 3 == 0 ? 1e-9 : 0.01 * double(1 + i % 5);
  const MeshLaplacian laplacian = *polygon_laplacian(mesh, kNeverCancelled);
  const auto kernel = HeatKernel::create(laplacian, times);
  ASSERT_TRUE(kernel.ok());
  std::vector<float> block(count * HeatKernel::kColumns, 1.0f);
  const auto at = [&](size_t node, size_t k) -> float& {
    return block[kernel->place(node) * HeatKernel::kColumns + k];
  };
  Eigen::VectorXd noisy(laplacian.area.size()), weight(laplacian.area.size());
  for (size_t i = 0; i < count; ++i) {
    at(i, 0) = static_cast<float>(std::sin(double(i * i)));
    noisy[Eigen::Index(i)] = at(i, 0);
    weight[Eigen::Index(i)] = laplacian.area[Eigen::Index(i)] / times[i];
  }
  ASSERT_TRUE(kernel->smooth(block, kNeverCancelled));
  const Eigen::SparseMatrix<double> whole = laplacian.stiffness.selfadjointView<Eigen::Lower>();
  Eigen::MatrixXd dense = whole;
  dense.diagonal() += weight;
  const Eigen::VectorXd expected = dense.llt().solve(weight.cwiseProduct(noisy));
  for (size_t i = 0; i < count; ++i) {
    EXPECT_NEAR(at(i, 0), expected[Eigen::Index(i)], kRounding);
    if (i % 3 == 0) {
      EXPECT_NEAR(at(i, 0), noisy[Eigen::Index(i)], 1e-5);
    }
    EXPECT_NEAR(at(i, 1), 1.0, kRounding);
  }
}

// RMS over points of harmonic coordinates in the box from -1 to 1, where they are trilinear.
double error_in_box(const QueryInput& mesh, Denoise denoise, Preset preset = Preset::kDefault) {
  const Options options{.preset = preset, .denoise = denoise};
  const RowBlock rows = testing::bind_or_die(testing::make_index(testing::box()), mesh, options);
  double squared = 0.0;
  for (size_t i = 0; i < rows.row_count(); ++i) {
    const auto row = testing::dense_row(rows, i, 8);
    const double* x = mesh.points.data() + 3 * i;
    for (size_t v = 0; v < 8; ++v)
      squared += std::pow(row[v] - (1 + ((v & 4) != 0 ? x[0] : -x[0])) * (1 + ((v & 2) != 0 ? x[1] : -x[1])) *
                                       (1 + ((v & 1) != 0 ? x[2] : -x[2])) / 8,
                          2);
  }
  return std::sqrt(squared / double(rows.row_count()));
}

TEST(Smoothing, HalvesTheNoise) {
  const QueryInput mesh = testing::mesh_of(testing::sphere(24, 0.7));
  EXPECT_LT(error_in_box(mesh, Denoise::kMesh), 0.5 * error_in_box(mesh, Denoise::kNone));
}

// A sphere's mesh moved onto a box within the one from -1 to 1.
QueryInput mesh_along_the_box(double size) {
  QueryInput mesh = testing::mesh_of(testing::sphere(16, 1.0));
  for (size_t i = 0; i < mesh.points.size(); i += 3) {
    Eigen::Map<Vec<3>> x(mesh.points.data() + i);
    x *= size / x.lpNorm<Eigen::Infinity>();
  }
  return mesh;
}

// Where the mesh is coarser than its distance from the cage, coordinates change from node to node, and there is little
// noise. One time for all nodes, as the paper has it, makes the error nine times that of the samples.
TEST(Smoothing, KeepsWhatIsNearTheCage) {
  const QueryInput mesh = mesh_along_the_box(0.98);
  const double raw = error_in_box(mesh, Denoise::kNone);
  EXPECT_LT(error_in_box(mesh, Denoise::kMesh), 1.1 * raw);
  EXPECT_GT(error_in_box(mesh, Denoise::kMesh, Preset::kPaper), 5 * raw);
}

TEST(Smoothing, KeepsMeanValuesNearTheCage) {
  const auto index = testing::make_index(testing::triangulated(testing::box()));
  const QueryInput mesh = mesh_along_the_box(0.98);
  const auto bind = [&](Denoise denoise, Estimator estimator) {
    return testing::bind_or_die(
        index, mesh, {.coordinates = CoordinateKind::kMeanValue, .estimator = estimator, .denoise = denoise});
  };
  const RowBlock exact = bind(Denoise::kAuto, Estimator::kExact);
  const auto error = [&](const RowBlock& rows) {
    double squared = 0.0;
    for (size_t i = 0; i < rows.row_count(); ++i) {
      const auto row = testing::dense_row(rows, i, 8), expected = testing::dense_row(exact, i, 8);
      for (size_t v = 0; v < 8; ++v) squared += std::pow(row[v] - expected[v], 2);
    }
    return std::sqrt(squared / double(rows.row_count()));
  };
  EXPECT_LT(error(bind(Denoise::kMesh, Estimator::kSampling)), 1.3 * error(bind(Denoise::kNone, Estimator::kSampling)));
}

// Shards that pass one time smooth alike: what else is in the set does not matter to a component.
TEST(Smoothing, TimesDependOnNoOtherPoint) {
  const auto index = testing::make_index(testing::box());
  QueryInput mesh = testing::mesh_of(testing::sphere(16, 0.5));
  const Options options{.smoothing_time = 1e-3};
  const RowBlock alone = testing::bind_or_die(index, mesh, options);
  const auto count = static_cast<uint32_t>(mesh.points.size() / 3);
  const QueryInput near = mesh_along_the_box(0.98);
  mesh.points.insert(mesh.points.end(), near.points.begin(), near.points.end());
  for (size_t f = 0; f + 1 < near.face_offsets.size(); ++f) {
    for (uint32_t c = near.face_offsets[f]; c < near.face_offsets[f + 1]; ++c)
      mesh.face_corners.push_back(count + near.face_corners[c]);
    mesh.face_offsets.push_back(static_cast<uint32_t>(mesh.face_corners.size()));
  }
  const RowBlock both = testing::bind_or_die(index, mesh, options);
  for (size_t i = 0; i < count; ++i) {
    const auto a = testing::dense_row(alone, i, 8), b = testing::dense_row(both, i, 8);
    for (size_t v = 0; v < 8; ++v) EXPECT_NEAR(a[v], b[v], 1e-12);
  }
}

// A mesh with long edges: next to the cage nothing is averaged over any length.
TEST(Smoothing, WarnsOfALongReachOnlyWhereThereIsOne) {
  const auto warned = [](double size) {
    const testing::Shape mesh = testing::box().mapped([&](const auto& x) { return size * x; });
    BindingSummary summary;
    testing::bind_or_die(testing::make_index(testing::box()), testing::mesh_of(mesh), {}, &summary);
    return std::any_of(summary.warnings.begin(), summary.warnings.end(),
                       [](const Warning& warning) { return warning.field == "smoothing_time"; });
  };
  EXPECT_TRUE(warned(0.15));
  EXPECT_FALSE(warned(0.99));
}

TEST(Smoothing, TimeNearTheCageFollowsSamples) {
  const auto walks = ErrorRate::kSquareRoot, rays = ErrorRate::kLinear;
  EXPECT_NEAR(smoothing_time_per_squared_distance(walks, 50), 0.2, 1e-15);
  EXPECT_NEAR(smoothing_time_per_squared_distance(walks, 400), 0.1, 1e-15);
  EXPECT_NEAR(smoothing_time_per_squared_distance(rays, 50), 0.05, 1e-15);
  EXPECT_NEAR(smoothing_time_per_squared_distance(rays, 400), 0.05 / 16, 1e-15);
  EXPECT_NEAR(smoothing_time_per_squared_distance(rays, 16), 0.05 * std::cbrt(3.125 * 3.125), 1e-15);
}

TEST(Smoothing, KeepsThePointsOnTheCage) {
  const auto index = testing::make_index(testing::box());
  // A sphere that touches the six walls at its poles and equator.
  const QueryInput mesh = testing::mesh_of(testing::sphere(16, 1.0));
  Options options;
  const RowBlock rows = testing::bind_or_die(index, mesh, options);
  size_t touching = 0;
  for (size_t i = 0; i < rows.row_count(); ++i) {
    const double* x = mesh.points.data() + 3 * i;
    if (std::max({std::abs(x[0]), std::abs(x[1]), std::abs(x[2])}) < 1 - 1e-12) continue;
    ++touching;
    ASSERT_TRUE(rows.flags[i] & kRowOnCage);
    const auto row = testing::dense_row(rows, i, 8);
    for (size_t v = 0; v < 8; ++v)
      EXPECT_NEAR(row[v],
                  (1 + ((v & 4) != 0 ? x[0] : -x[0])) * (1 + ((v & 2) != 0 ? x[1] : -x[1])) *
                      (1 + ((v & 1) != 0 ? x[2] : -x[2])) / 8,
                  1e-12);
  }
  EXPECT_GE(touching, 6u);
}

// Two half spheres with their own copies of the seam's points, an isolated point, a face without area,
// quads and triangles, two components.
TEST(Smoothing, TreatsCoincidentPointsAsOne) {
  const testing::Shape sphere = testing::sphere(12, 0.6);
  QueryInput mesh = testing::mesh_of(sphere);
  const size_t original = mesh.points.size() / 3;
  const std::vector<double> copy = mesh.points;
  mesh.points.insert(mesh.points.end(), copy.begin(), copy.end());
  // Every second face uses the copies.
  for (size_t f = 0; f + 1 < mesh.face_offsets.size(); f += 2)
    for (uint32_t c = mesh.face_offsets[f]; c < mesh.face_offsets[f + 1]; ++c)
      mesh.face_corners[c] += static_cast<uint32_t>(original);
  mesh.points.insert(mesh.points.end(), {0.1, 0.2, 0.3});
  mesh.face_corners.insert(mesh.face_corners.end(), {0, 0, 1});
  mesh.face_offsets.push_back(static_cast<uint32_t>(mesh.face_corners.size()));
  const auto index = testing::make_index(testing::box());
  const Options options{.smoothing_time = 1e-3};
  BindingSummary summary;
  const RowBlock rows = testing::bind_or_die(index, mesh, options, &summary);
  const RowBlock whole = testing::bind_or_die(index, testing::mesh_of(sphere), options);
  for (size_t i = 0; i < original; ++i) {
    const auto a = testing::dense_row(rows, i, 8), b = testing::dense_row(rows, i + original, 8),
               c = testing::dense_row(whole, i, 8);
    EXPECT_EQ(a, b) << "a seam cracked";
    // The order of elimination differs.
    for (size_t v = 0; v < 8; ++v) EXPECT_NEAR(a[v], c[v], kRounding);
  }
  const auto raw = testing::bind_or_die(index, testing::loose_points({0.1, 0.2, 0.3}), {});
  const auto isolated = testing::dense_row(rows, 2 * original, 8), alone = testing::dense_row(raw, 0, 8);
  for (size_t v = 0; v < 8; ++v) EXPECT_NEAR(isolated[v], alone[v], 1e-12);
  EXPECT_EQ(summary.warnings.size(), 3u);  // coincident points, a face without area, an isolated point
}

TEST(Smoothing, AcceptsAMeshWithoutArea) {
  const auto index = testing::make_index(testing::box());
  const QueryInput mesh{.points = {0, 0, 0, 0.1, 0, 0, 0.2, 0, 0}, .face_offsets = {0, 3}, .face_corners = {0, 1, 2}};
  BindingSummary summary;
  const RowBlock rows = testing::bind_or_die(index, mesh, {}, &summary);
  const RowBlock loose = testing::bind_or_die(index, testing::loose_points(mesh.points), {});
  for (size_t i = 0; i < 3; ++i) {
    const auto a = testing::dense_row(rows, i, 8), b = testing::dense_row(loose, i, 8);
    for (size_t v = 0; v < 8; ++v) EXPECT_NEAR(a[v], b[v], 1e-12);
  }
  EXPECT_EQ(summary.warnings.size(), 2u);
}

// Faces that connect points at random, as a file with another file's indices: the factor would be dense.
TEST(Smoothing, LeavesOutWhatIsNoSurface) {
  const auto index = testing::make_index(testing::box());
  constexpr uint32_t kPoints = 12000;
  QueryInput mesh = testing::loose_points(testing::random_points(kPoints, 3, -0.9, 0.9, 1));
  std::mt19937 generator(1);
  mesh.face_offsets = {0};
  for (uint32_t i = 0; i < 2 * kPoints; ++i) {
    for (int k = 0; k < 3; ++k) mesh.face_corners.push_back(static_cast<uint32_t>(generator() % kPoints));
    mesh.face_offsets.push_back(static_cast<uint32_t>(mesh.face_corners.size()));
  }
  Options options;
  options.samples = 1;
  BindingSummary summary;
  const RowBlock rows = testing::bind_or_die(index, mesh, options, &summary);
  EXPECT_EQ(rows.row_count(), kPoints);
  const auto left_out = [](const Warning& w) { return w.message.find("no surface-like way") != std::string::npos; };
  EXPECT_TRUE(std::any_of(summary.warnings.begin(), summary.warnings.end(), left_out));
}

// A triangle far smaller than the kernel's reach must not spoil the others' denoising.
TEST(Smoothing, IsNotSpoiltByATinyComponent) {
  const auto index = testing::make_index(testing::box());
  QueryInput mesh = testing::mesh_of(testing::sphere(16, 0.7));
  BindingSummary summary_alone;
  const RowBlock alone = testing::bind_or_die(index, mesh, {}, &summary_alone);
  const auto first = static_cast<uint32_t>(mesh.points.size() / 3);
  mesh.points.insert(mesh.points.end(), {0.1, 0.1, 0.1, 0.1 + 1e-10, 0.1, 0.1, 0.1, 0.1 + 1e-10, 0.1});
  mesh.face_corners.insert(mesh.face_corners.end(), {first, first + 1, first + 2});
  mesh.face_offsets.push_back(static_cast<uint32_t>(mesh.face_corners.size()));
  BindingSummary summary;
  Options options;
  options.smoothing_time = summary_alone.smoothing_time;
  const RowBlock both = testing::bind_or_die(index, mesh, options, &summary);
  EXPECT_TRUE(summary.warnings.empty());
  for (size_t i = 0; i < first; ++i) {
    const auto a = testing::dense_row(alone, i, 8), b = testing::dense_row(both, i, 8);
    for (size_t v = 0; v < 8; ++v) EXPECT_NEAR(a[v], b[v], 1e-9);
  }
}

TEST(Smoothing, AcceptsTheTimeOfAnEarlierAnswer) {
  const auto index = testing::make_index(testing::box());
  const QueryInput mesh = testing::mesh_of(testing::sphere(10, 0.6));
  BindingSummary first, second;
  const RowBlock rows = testing::bind_or_die(index, mesh, {}, &first);
  Options options;
  options.smoothing_time = first.smoothing_time;
  EXPECT_EQ(testing::bind_or_die(index, mesh, options, &second).values, rows.values);
  EXPECT_EQ(second.smoothing_time, first.smoothing_time);
}

// The time that a binding chooses, in squared edges of a mesh; the box's diagonal is sqrt(12).
double chosen_time(const QueryInput& mesh, Preset preset, CoordinateKind kind, uint32_t samples) {
  Options options;
  options.preset = preset;
  options.estimator = Estimator::kSampling;
  options.coordinates = kind;
  options.samples = samples;
  BindingSummary summary;
  testing::bind_or_die(testing::make_index(testing::box()), mesh, options, &summary);
  return 12 * summary.smoothing_time;
}

TEST(Smoothing, TimeFollowsEdgesAndSamples) {
  // A strip of ten right angles with legs 0.1, and a far larger one.
  QueryInput mesh{.points = {}, .face_offsets = {0}, .face_corners = {}};
  for (uint32_t i = 0; i < 11; ++i) {
    const double size = i < 10 ? 0.1 : 1.0;
    mesh.points.insert(mesh.points.end(),
                       {-0.9, 0, -0.5 + 0.1 * i, -0.9 + size, 0, -0.5 + 0.1 * i, -0.9, size, -0.5 + 0.1 * i});
    mesh.face_corners.insert(mesh.face_corners.end(), {3 * i, 3 * i + 1, 3 * i + 2});
    mesh.face_offsets.push_back(3 * (i + 1));
  }
  const double median = 0.01, mean = (10 * (0.01 + 0.01 + 0.02) + 1 + 1 + 2) / 33;
  const auto harmonic = CoordinateKind::kHarmonic, mean_value = CoordinateKind::kMeanValue;
  const SquaredEdges edges{.mean = mean, .median = median};
  EXPECT_NEAR(smoothing_time(edges, 0.1), 28 * 0.1 / 1.2 * median, 1e-15);
  EXPECT_NEAR(smoothing_time(edges, 0.01), 28 * 0.01 / 1.02 * median, 1e-15);
  // Of a few points the noise is not measured.
  EXPECT_NEAR(chosen_time(mesh, Preset::kDefault, mean_value, 100), smoothing_time(edges, 0.1), 1e-12);
  EXPECT_NEAR(chosen_time(mesh, Preset::kPaper, harmonic, 50), (5 - std::log10(50)) * mean, 1e-12);
  EXPECT_NEAR(chosen_time(mesh, Preset::kPaper, mean_value, 1000), 2 * mean, 1e-12);
}

// Walks of a noise near 1 / sqrt(m), and lattices of rays of far less.
TEST(Smoothing, TimeFollowsTheNoise) {
  const QueryInput mesh = testing::mesh_of(testing::sphere(16, 0.5));
  const SquaredEdges edges = *squared_edges(to_mesh(mesh), kNeverCancelled);
  for (const uint32_t samples : {50u, 400u}) {
    const double independent = smoothing_time(edges, 1 / std::sqrt(samples));
    const double walks = chosen_time(mesh, Preset::kDefault, CoordinateKind::kHarmonic, samples);
    EXPECT_GT(walks, 0.4 * independent);
    EXPECT_LT(walks, 1.5 * independent);
    EXPECT_LT(chosen_time(mesh, Preset::kDefault, CoordinateKind::kMeanValue, samples), 0.5 * walks);
  }
}

// The same for the same points in another order.
TEST(Smoothing, TimeFollowsNoOrder) {
  testing::Shape shape = testing::sphere(16, 0.5);
  const double time = chosen_time(testing::mesh_of(shape), Preset::kDefault, CoordinateKind::kHarmonic, 50);
  const auto count = static_cast<uint32_t>(shape.vertex_count());
  testing::Shape reversed = shape;
  for (uint32_t i = 0; i < count; ++i)
    for (uint32_t k = 0; k < 3; ++k) reversed.vertices[3 * (count - 1 - i) + k] = shape.vertices[3 * i + k];
  for (auto* list : {&reversed.triangles, &reversed.quads})
    for (uint32_t& v : *list) v = count - 1 - v;
  EXPECT_EQ(chosen_time(testing::mesh_of(reversed), Preset::kDefault, CoordinateKind::kHarmonic, 50), time);
}

RowBlock bind_with(KernelCache& kernels, const QueryInput& mesh, const Options& options, BindingSummary& summary) {
  auto binding = Binding::create(testing::make_index(testing::box()), mesh,
                                 {.options = *resolve(options, true), .block_rows = 100000, .kernels = &kernels});
  EXPECT_TRUE(binding.ok());
  RowBlock rows;
  for (Binding::Step step = Binding::Step::kWorking; step != Binding::Step::kDone;) {
    step = (*binding)->advance(kNeverCancelled);
    if (step == Binding::Step::kBlock) rows = (*binding)->take_block();
  }
  summary = (*binding)->summary();
  return rows;
}

TEST(KernelCache, AHitChangesNothingButTime) {
  KernelCache kernels(1 << 24);
  QueryInput mesh = testing::mesh_of(testing::sphere(16, 0.7));
  // A point without faces, and a face without area: what is said of them is said again.
  mesh.points.insert(mesh.points.end(), {0.1, 0.2, 0.3});
  mesh.face_corners.insert(mesh.face_corners.end(), {0, 0, 1});
  mesh.face_offsets.push_back(static_cast<uint32_t>(mesh.face_corners.size()));
  BindingSummary first, second, other;
  const RowBlock a = bind_with(kernels, mesh, {}, first), b = bind_with(kernels, mesh, {}, second);
  EXPECT_EQ(kernels.stats().hits, 1u);
  EXPECT_EQ(kernels.stats().misses, 1u);
  EXPECT_EQ(a.values, b.values);
  EXPECT_EQ(a.values, testing::bind_or_die(testing::make_index(testing::box()), mesh, {}).values);
  ASSERT_EQ(first.warnings.size(), 2u);
  ASSERT_EQ(second.warnings.size(), 2u);
  for (size_t i = 0; i < 2; ++i) EXPECT_EQ(first.warnings[i].message, second.warnings[i].message);
  // Another time, another position, another face: another kernel.
  const Options later{.smoothing_time = 1e-3};
  bind_with(kernels, mesh, later, other);
  EXPECT_EQ(kernels.stats().misses, 2u);
  mesh.points[0] += 1e-9;
  bind_with(kernels, mesh, later, other);
  EXPECT_EQ(kernels.stats().misses, 3u);
  std::swap(mesh.face_corners[0], mesh.face_corners[1]);
  bind_with(kernels, mesh, later, other);
  EXPECT_EQ(kernels.stats().misses, 4u);
  EXPECT_EQ(kernels.stats().entries, 4u);
}

TEST(KernelCache, KeepsWithinItsBytes) {
  const QueryInput mesh = testing::mesh_of(testing::sphere(16, 0.7));
  BindingSummary summary;
  KernelCache large(1 << 24);
  bind_with(large, mesh, {}, summary);
  const uint64_t one = large.stats().bytes;
  KernelCache small(one + one / 2), none(one - 1);
  for (const double time : {1e-3, 2e-3, 1e-3}) {
    bind_with(small, mesh, {.smoothing_time = time}, summary);
    bind_with(none, mesh, {.smoothing_time = time}, summary);
    EXPECT_LE(small.stats().bytes, one + one / 2);
  }
  EXPECT_EQ(small.stats().entries, 1u);
  EXPECT_EQ(small.stats().evictions, 2u);
  EXPECT_EQ(small.stats().hits, 0u);
  EXPECT_EQ(none.stats().entries, 0u);
}

}  // namespace
}  // namespace barycast
