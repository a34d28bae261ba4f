// Rows by prediction and correction, through the library's entry: on the cage, next to it and far from it, the
// promises, and what is refused.

#include <gtest/gtest.h>

#include <map>
#include <string>

#include "query/distance_index.h"
#include "query/element_distance.h"
#include "query/winding.h"
#include "solve/panels.h"
#include "solve/prediction.h"
#include "support/harmonic_gradients.h"
#include "support/seeds.h"

namespace barycast {
namespace {

using testing::Shape;

struct Case {
  const char* name;
  Shape shape;
  double step = 1e-3;  // across the thickness
};
void PrintTo(const Case& some, std::ostream* out) {
  *out << some.name;
}

Options predicted(bool gradients = false) {
  return {.estimator = Estimator::kPredicted, .seed = 3, .prune_below = 0.0, .gradients = gradients};
}

void append(std::vector<double>& points, const Vec<3>& x) {
  points.insert(points.end(), x.data(), x.data() + 3);
}

// One for all tests: predictions are solved once.
std::shared_ptr<const CageIndex> index_of(const Case& some) {
  static std::map<std::string, std::shared_ptr<const CageIndex>> known;
  std::shared_ptr<const CageIndex>& index = known[some.name];
  if (!index) {
    index = *CageIndex::create(some.shape.input());
    EXPECT_TRUE(index->prepare(*resolve(predicted(), false)).ok());
  }
  return index;
}

class PredictedRows : public ::testing::TestWithParam<Case> {
 protected:
  std::shared_ptr<const CageIndex> index_ = index_of(GetParam());
  const CageStructures<3>& structures_ = *std::get<std::unique_ptr<const CageStructures<3>>>(index_->structures());
  const Cage<3>& cage_ = structures_.cage;
  size_t vertices_ = index_->control_vertex_count();

  // A point of the cage: inside of an element, on its first edge, at its first corner.
  struct Place {
    Vec<3> y, normal;
    Eigen::VectorXd basis;
  };
  std::vector<Place> places() const {
    std::vector<Place> result;
    for (const Element& element : cage_.elements())
      for (const auto& at : {Vec<2>(0.23, 0.31), Vec<2>(0.62, 0.17), Vec<2>(0.4, 0.0), Vec<2>(0.0, 0.0)}) {
        const double u = at[0], v = at[1];
        std::array<double, 4> shares{1 - u - v, u, v, 0.0};
        if (element.kind == ElementKind::kQuad) shares = {(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v};
        Place place{Vec<3>::Zero(), element_normal(cage_, element, shares),
                    Eigen::VectorXd::Zero(Eigen::Index(vertices_))};
        for (int i = 0; i < element.corner_count(); ++i)
          place.y += shares[static_cast<size_t>(i)] * cage_.corner(element, i);
        std::vector<VertexWeight> basis;
        cage_.append_basis(element, shares, 1.0, basis);
        for (const VertexWeight& phi : basis) place.basis[phi.vertex] += phi.weight;
        result.push_back(place);
      }
    return result;
  }

  std::vector<Eigen::VectorXd> rows(const std::vector<double>& points, const Options& options,
                                    RowBlock* block = nullptr) const {
    const RowBlock bound = testing::bind_or_die(index_, testing::loose_points(points), options);
    std::vector<Eigen::VectorXd> result;
    for (size_t i = 0; i < bound.row_count(); ++i) result.push_back(testing::row_vector(bound, i, vertices_));
    if (block != nullptr) *block = bound;
    return result;
  }
};

TEST_P(PredictedRows, AreTheBasisOnTheCage) {
  std::vector<double> points;
  for (const Place& place : places()) append(points, cage_.frame().to_caller(place.y));
  RowBlock block;
  const auto found = rows(points, predicted(), &block);
  size_t i = 0;
  for (const Place& place : places()) {
    EXPECT_LT((found[i] - place.basis).cwiseAbs().maxCoeff(), 1e-10) << i;
    // Beside an edge may be on another element: nothing but one point is seen from there.
    EXPECT_EQ(block.flags[i] | kRowRankDeficient, kRowOnCage | kRowRankDeficient) << i;
    if (i % 4 < 2) {
      EXPECT_EQ(block.flags[i], kRowOnCage) << i;
    }
    ++i;
  }
}

// alpha = phi(y) + g . (x - y), with the gradient g that is asked for.
TEST_P(PredictedRows, AreLinearNextToTheCage) {
  std::vector<double> points;
  for (const Place& place : places())
    for (const double height : {0.0, 4e-4, -7e-4})
      append(points, cage_.frame().to_caller(place.y + height * place.normal));
  RowBlock block;
  const auto found = rows(points, predicted(true), &block);
  EXPECT_EQ(block.values, testing::bind_or_die(index_, testing::loose_points(points), predicted()).values);
  for (size_t i = 0; i < found.size(); ++i) {
    const Vec<3> x = cage_.frame().to_normalized(Eigen::Map<const Vec<3>>(&points[3 * i]));
    const CagePoint<3> y = (*structures_.walks).closest(x);
    EXPECT_TRUE((block.flags[i] & kRowOnCage) != 0);
    Eigen::VectorXd expected = Eigen::VectorXd::Zero(Eigen::Index(vertices_));
    std::vector<VertexWeight> basis;
    cage_.append_basis(cage_.elements()[y.element], y.shares, 1.0, basis);
    for (const VertexWeight& phi : basis) expected[phi.vertex] += phi.weight;
    for (uint32_t e = block.offsets[i]; e < block.offsets[i + 1]; ++e)
      expected[block.indices[e]] +=
          (x - y.point).dot(Eigen::Map<const Vec<3>>(&block.gradients[3 * e])) * cage_.frame().diagonal;
    EXPECT_LT((found[i] - expected).cwiseAbs().maxCoeff(), 1e-10) << i;
  }
}

// A step there is the noise of the correction, and what the coordinates bend over the thickness: little off edges.
TEST_P(PredictedRows, AreContinuousAcrossTheThickness) {
  std::vector<double> points;
  const std::vector<Place> all = places();
  for (size_t i = 0; i < all.size(); ++i)
    for (const double side : {-1.0, 1.0})
      for (const double height : {0.999e-3, 1.001e-3})
        if (i % 4 < 2) append(points, cage_.frame().to_caller(all[i].y + side * height * all[i].normal));
  Options options = predicted();
  options.samples = 300;
  const auto found = rows(points, options);
  double squared = 0.0;
  for (size_t i = 0; i < found.size(); i += 2) squared += (found[i] - found[i + 1]).squaredNorm();
  // Twisted quads lie off their panels by as much as that: beyond one the slope is that of its other side.
  EXPECT_LT(std::sqrt(squared / double(found.size() / 2)), GetParam().step);
}

// Everywhere, at the control vertices, on the cage and so far out that coordinates are large.
TEST_P(PredictedRows, KeepThePromises) {
  std::vector<double> points = testing::random_points(60, 3, -2, 2, 8);
  for (const double value : testing::random_points(10, 3, -1e4, 1e4, 9)) points.push_back(value);
  for (const Place& place : places()) append(points, cage_.frame().to_caller(place.y + 3e-4 * place.normal));
  const std::vector<double>& own = GetParam().shape.vertices;
  points.insert(points.end(), own.begin(), own.end());
  for (const double prune : {0.0, 1e-4}) {
    Options options = predicted(true);
    options.prune_below = prune;
    const RowBlock block = testing::bind_or_die(index_, testing::loose_points(points), options);
    EXPECT_LE(testing::promise_error<3>(*index_, points, block).worst(), 1.0) << prune;
    const QueryInput mesh = testing::mesh_of(testing::sphere(12, 1.1));
    EXPECT_LE(testing::promise_error<3>(*index_, mesh.points, testing::bind_or_die(index_, mesh, options)).worst(), 1.0)
        << prune;
  }
}

TEST_P(PredictedRows, SayWhereTheyAre) {
  const std::vector<double> points = testing::random_points(100, 3, -1.6, 1.6, 10);
  BindingSummary summary, plain;
  const RowBlock block = testing::bind_or_die(index_, testing::loose_points(points), predicted(), &summary);
  const RowBlock sampled = testing::bind_or_die(index_, testing::loose_points(points),
                                                {.estimator = Estimator::kSampling, .samples = 50}, &plain);
  constexpr int kPlace = kRowOnCage | kRowOutside;
  for (size_t i = 0; i < 100; ++i) EXPECT_EQ(block.flags[i] & kPlace, sampled.flags[i] & kPlace) << i;
  EXPECT_EQ(summary.rows_outside, plain.rows_outside);
  EXPECT_EQ(summary.samples, 1200u);
  EXPECT_EQ(summary.rows_no_samples, 0u);
}

// Points next to the cage and far from it, against many walks: never worse than without a prediction.
TEST_P(PredictedRows, AreNoWorseThanSamplesNearAndFar) {
  std::vector<double> near, far;
  const std::vector<Place> all = places();
  for (size_t i = 0; i < all.size(); i += 1 + all.size() / 25)
    for (const double height : {-0.004, 0.002})
      append(near, cage_.frame().to_caller(all[i].y + height * all[i].normal));
  const std::vector<double> directions = testing::random_points(10, 3, -1, 1, 11);
  for (const double reach : {1.0, 5.0})
    for (size_t i = 0; i < directions.size(); i += 3)
      append(far, cage_.frame().to_caller(reach * Eigen::Map<const Vec<3>>(&directions[i]).normalized()));
  const auto ratio = [&](const std::vector<double>& points) {
    const auto reference = rows(
        points, {.estimator = Estimator::kSampling, .samples = 3000, .seed = 9, .thickness = 2e-4, .prune_below = 0.0});
    const auto squared_error = [&](Options options) {
      options.samples = 12;
      return testing::squared_difference(rows(points, options), reference);
    };
    return std::sqrt(squared_error(predicted()) /
                     squared_error({.estimator = Estimator::kSampling, .seed = 3, .prune_below = 0.0}));
  };
  EXPECT_LT(ratio(near), 0.9);
  EXPECT_LT(ratio(far), 0.2);
}

INSTANTIATE_TEST_SUITE_P(Cages, PredictedRows,
                         ::testing::Values(Case{"box", testing::box()}, Case{"bent_prism", testing::bent_prism(), 0.02},
                                           Case{"mixed_prism", testing::mixed_prism(), 0.005},
                                           Case{"open_box", testing::open_box()}, Case{"soup", testing::soup()}),
                         [](const auto& info) { return std::string(info.param.name); });

// A grid of quads, n x m, that spans space.
Shape sheet(uint32_t n, uint32_t m, double height) {
  Shape shape;
  for (uint32_t i = 0; i <= n; ++i)
    for (uint32_t j = 0; j <= m; ++j) {
      const double x = 2.0 * i / n - 1, y = 2.0 * j / m - 1;
      shape.vertices.insert(shape.vertices.end(), {x, y, height * (std::sin(3 * x) + x * std::cos(2 * y))});
    }
  for (uint32_t i = 0; i < n; ++i)
    for (uint32_t j = 0; j < m; ++j) {
      const uint32_t a = i * (m + 1) + j;
      shape.quads.insert(shape.quads.end(), {a, a + 1, a + m + 2, a + m + 1});
    }
  return shape;
}

// Within the thickness of two walls a point is inside, and the place beside the one is beyond the other.
TEST(PredictedRowsOfThinCages, AreFinite) {
  const auto index = testing::make_index(testing::thin_box());
  std::vector<double> points = testing::random_points(50, 3, -0.9, 0.9, 12);
  for (size_t i = 2; i < points.size(); i += 3) points[i] *= 1e-3;
  const RowBlock block = testing::bind_or_die(index, testing::loose_points(points), predicted(true));
  for (size_t i = 0; i < block.row_count(); ++i) EXPECT_NE(block.flags[i] & kRowOnCage, 0);
  for (const double value : block.values) EXPECT_LT(std::abs(value), 2.0);
  for (const double value : block.gradients) EXPECT_TRUE(std::isfinite(value));
  EXPECT_LE(testing::promise_error<3>(*index, points, block).worst(), 1.0);
}

// Coordinates are large there, for the moments hardly span space. Of an open sheet, however flat it is, predicted ones
// have a fraction of the error; of a flat box no more.
TEST(PredictedRowsOfThinCages, HaveLessErrorOutsideThanSamples) {
  Shape flat_box = testing::box();
  for (size_t i = 2; i < flat_box.vertices.size(); i += 3) flat_box.vertices[i] *= 1e-2;
  for (const auto& [shape, part] :
       {std::pair{sheet(4, 4, 1e-2), 0.4}, std::pair{sheet(4, 4, 2e-3), 0.4}, std::pair{flat_box, 1.0}}) {
    const auto index = testing::make_index(shape);
    std::vector<double> points = testing::random_points(60, 3, -1.3, 1.3, 14);
    for (size_t i = 2; i < points.size(); i += 3) points[i] = 0.3 * points[i] + std::copysign(0.05, points[i]);
    const QueryInput queries = testing::loose_points(points);
    Options options{.estimator = Estimator::kBoundaryElement, .panels = 1000, .prune_below = 0.0};
    const RowBlock exact = testing::bind_or_die(index, queries, options);
    const auto error = [&](const RowBlock& block) {
      double squared = 0.0;
      for (size_t i = 0; i < block.row_count(); ++i)
        squared += (testing::row_vector(block, i, index->control_vertex_count()) -
                    testing::row_vector(exact, i, index->control_vertex_count()))
                       .squaredNorm();
      return std::sqrt(squared / static_cast<double>(block.row_count()));
    };
    const double off = error(testing::bind_or_die(index, queries, predicted()));
    options = {.estimator = Estimator::kSampling, .samples = 50, .prune_below = 0.0};
    EXPECT_LT(off, part * error(testing::bind_or_die(index, queries, options)));
  }
}

// Near the sphere, by as many walks as everywhere, they would be off by .155 of their size. Values have none of that.
TEST(PredictedRows, HaveTheirGradientsNearTheCage) {
  for (const Shape& shape : {testing::sphere(6, 1.0), testing::bent_prism()}) {
    const auto index = testing::make_index(shape);
    const CageStructures<3>& structures = *std::get<std::unique_ptr<const CageStructures<3>>>(index->structures());
    const Cage<3>& cage = structures.cage;
    std::vector<double> points;
    for (const Element& element : cage.elements())
      for (const auto& shares : {std::array<double, 4>{0.3, 0.2, 0.2, 0.3}, {0.05, 0.05, 0.45, 0.45}}) {
        const Vec<3> y = point_at(cage, element, shares);
        const Vec<3> x = y - 2.5e-3 * cage.orientation() * element_normal(cage, element, shares);
        append(points, cage.frame().diagonal * x + cage.frame().centre);
      }
    const testing::DenseRows exact = testing::harmonic_gradients(cage, points, 5000);
    const QueryInput queries = testing::loose_points(points);
    const RowBlock block = testing::bind_or_die(index, queries, predicted(true));
    double squared = 0.0;
    for (size_t i = 0; i < block.row_count(); ++i)
      for (uint32_t e = block.offsets[i]; e < block.offsets[i + 1]; ++e)
        for (uint32_t a = 0; a < 3; ++a)
          squared +=
              std::pow(block.gradients[3 * e + a] -
                           exact(static_cast<Eigen::Index>(i),
                                 static_cast<Eigen::Index>(a * index->control_vertex_count() + block.indices[e])),
                       2);
    EXPECT_LT(std::sqrt(squared), 0.11 * exact.norm());
    EXPECT_EQ(block.values, testing::bind_or_die(index, queries, predicted(false)).values);
    // Whatever the number of walks, a row does not know the points before it.
    for (const uint32_t samples : {1u, 5u}) {
      Options few = predicted(true);
      few.samples = samples;
      const std::vector<double> last(points.end() - 3, points.end());
      const RowBlock all = testing::bind_or_die(index, queries, few),
                     alone = testing::bind_or_die(index, testing::loose_points(last), few);
      EXPECT_TRUE(std::equal(alone.gradients.begin(), alone.gradients.end(),
                             all.gradients.end() - static_cast<std::ptrdiff_t>(alone.gradients.size())));
    }
  }
}

std::string refused(const Shape& shape, const Options& options) {
  const auto resolved = resolve(options, false);
  if (!resolved) return resolved.error().field;
  const auto index = *CageIndex::create(shape.input());
  const Status known = index->check_estimator(*resolved);
  EXPECT_EQ(known.ok(), CageIndex::check_estimator(shape.input(), *resolved).ok());
  if (!known.ok()) {  // and is by the entry
    EXPECT_EQ(Binding::create(index, testing::loose_points(std::vector<double>(6, 0.1)), {.options = *resolved})
                  .error()
                  .field,
              known.error().field);
  }
  return known.ok() ? "" : known.error().field;
}

// 500 triangles, of which a quad is two, and 300 control vertices.
TEST(PredictedRowsAreRefused, ToCagesThatAreTooLarge) {
  Shape most = sheet(10, 25, 0.3);
  EXPECT_EQ(refused(most, predicted()), "");
  most.triangles = {0, 1, 30};
  EXPECT_EQ(refused(most, predicted()), "estimator");
  Shape vertices;  // 100 loose triangles
  vertices.vertices = testing::random_points(300, 3, -1, 1, 13);
  for (uint32_t v = 0; v < 300; ++v) vertices.triangles.push_back(v);
  EXPECT_EQ(refused(vertices, predicted()), "");
  vertices.vertices.insert(vertices.vertices.end(), {0.5, 0.5, 0.5});
  EXPECT_EQ(refused(vertices, predicted()), "estimator");
}

TEST(PredictedRowsAreRefused, WithOptionsThatMakeNoSense) {
  using enum Estimator;
  EXPECT_EQ(refused(testing::square(), predicted()), "estimator");
  EXPECT_EQ(refused(testing::box(), {.preset = Preset::kPaper, .estimator = kPredicted}), "estimator");
  for (const auto kind : {CoordinateKind::kMeanValue, CoordinateKind::kPositiveMeanValue})
    EXPECT_EQ(refused(testing::box(), {.coordinates = kind, .estimator = kPredicted}), "estimator");
  EXPECT_EQ(refused(testing::box(), {.estimator = kPredicted, .panels = 300}), "panels");
  EXPECT_EQ(refused(testing::box(), {.estimator = kPredicted, .samples = 0}), "samples");
  EXPECT_EQ(refused(testing::box(), {.estimator = kPredicted, .denoise = Denoise::kMesh}), "denoise");
  EXPECT_EQ(refused(testing::box(), {.estimator = kPredicted, .thickness = 1.0}), "thickness");
  EXPECT_EQ(resolve(predicted(), false)->samples, 12u);
  EXPECT_EQ(resolve(predicted(), true)->denoise, Denoise::kMesh);
}

}  // namespace
}  // namespace barycast
