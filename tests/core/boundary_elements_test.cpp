// Boundary elements: their integrals against quadrature, their solution against closed forms, walks and itself.

#include "solve/boundary_elements.h"

#include <gtest/gtest.h>
#include <tbb/task_arena.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <numeric>
#include <random>

#include "query/distance_index.h"
#include "query/element_distance.h"
#include "query/winding.h"
#include "solve/panel_potential.h"
#include "support/mean_value.h"
#include "support/rows.h"

namespace barycast {
namespace {

using testing::Shape;

const CageStructures<3>& structures_of(const CageIndex& index) {
  return *std::get<std::unique_ptr<const CageStructures<3>>>(index.structures());
}

std::unique_ptr<const Solution<3>> solve(const CageIndex& index, uint32_t panels, bool moments = true) {
  auto solver = BoundarySolver::create(
      structures_of(index).cage, {.panels = panels, .sides = moments ? BoundarySides::kBoth : BoundarySides::kInside});
  EXPECT_TRUE(solver.ok());
  while ((*solver)->done() < (*solver)->total()) (*solver)->advance();
  return (*solver)->take(*structures_of(index).walks, *structures_of(index).winding);
}

// One panel in general position.
Panel some_panel() {
  const Shape shape{.vertices = {0.1, 0, 0, 1, 0.2, 0.1, 0.3, 0.9, -0.2, 0, 0, 2}, .triangles = {0, 1, 2, 0, 1, 3}};
  const auto index = testing::make_index(shape);
  const auto panels = Panels::cut(structures_of(*index).cage, 2);
  EXPECT_EQ(panels->panels.size(), 2u);
  return panels->panels[0];
}

// By the rule of seven points on 4 ^ depth parts.
Vec<3> integrate(const Panel& panel, const Vec<3>& x, const std::array<Vec<3>, 3>& corner, int depth) {
  if (depth > 0) {
    const std::array<Vec<3>, 3> middle = {0.5 * (corner[1] + corner[2]), 0.5 * (corner[2] + corner[0]),
                                          0.5 * (corner[0] + corner[1])};
    Vec<3> sum = integrate(panel, x, middle, depth - 1);
    for (size_t k = 0; k < 3; ++k)
      sum += integrate(panel, x, {corner[k], middle[(k + 2) % 3], middle[(k + 1) % 3]}, depth - 1);
    return sum;
  }
  const double area = 0.5 * (corner[1] - corner[0]).cross(corner[2] - corner[0]).norm();
  Vec<3> sum = Vec<3>::Zero();
  for (const TrianglePoint& rule : kTriangleRule) {
    Vec<3> y = Vec<3>::Zero();
    for (size_t k = 0; k < 3; ++k) y += rule.barycentric[k] * corner[k];
    for (Eigen::Index k = 0; k < 3; ++k)
      sum[k] += rule.weight * area * (1 / 3.0 + panel.gradient[static_cast<size_t>(k)].dot(y - panel.centre)) /
                (x - y).norm();
  }
  return sum;
}

// Around the panel, in its plane, and beyond its edges.
std::vector<Vec<3>> places_around(const Panel& panel) {
  std::vector<Vec<3>> places;
  for (const double height : {1e-3, -0.1, 0.5, 0.0})
    for (const double reach : {0.5, 1.3, 3.0})
      for (size_t k = 0; k < 3; ++k)
        if (height != 0.0 || reach > 1.0)
          places.push_back(panel.centre + height * panel.normal + reach * (panel.corner[k] - panel.centre));
  return places;
}

TEST(PanelPotential, IsTheIntegral) {
  const Panel panel = some_panel();
  for (const Vec<3>& x : places_around(panel)) {
    PanelPotential exact;
    exact_potential(panel, x, false, exact);
    const double distance = std::abs(panel.normal.dot(x - panel.centre));
    const double tolerance = distance > 0.05 || (x - panel.centre).norm() > 1.2 * panel.radius ? 1e-7 : 2e-4;
    EXPECT_LT((exact.value - integrate(panel, x, panel.corner, 8)).norm(), tolerance) << x.transpose();
  }
}

TEST(PanelPotential, GradientsAreThoseOfTheValues) {
  const Panel panel = some_panel();
  for (const Vec<3>& x : places_around(panel)) {
    PanelPotential exact, low, high;
    exact_potential(panel, x, true, exact);
    for (Eigen::Index k = 0; k < 3; ++k) {
      const Vec<3> step = 1e-5 * Vec<3>::Unit(k);
      exact_potential(panel, x - step, false, low);
      exact_potential(panel, x + step, false, high);
      for (size_t i = 0; i < 3; ++i) {
        const auto at = static_cast<Eigen::Index>(i);
        EXPECT_NEAR(exact.gradient[i][k], (high.value[at] - low.value[at]) / 2e-5, 1e-5) << x.transpose();
        // In the plane they jump inside of the panel alone; a thousandth off it they are steep.
        const double tolerance = std::abs(panel.normal.dot(x - panel.centre)) == 1e-3 ? 1e-2 : 1e-4;
        EXPECT_NEAR(exact.dipole_gradient[i][k], (high.dipole[at] - low.dipole[at]) / 2e-5, tolerance) << x.transpose();
      }
    }
  }
}

// A dipole is what a charge's potential loses along the normal.
TEST(PanelPotential, DipolesAreTheNormalDerivative) {
  const Panel panel = some_panel();
  for (const Vec<3>& x : places_around(panel)) {
    PanelPotential exact, low, high;
    exact_potential(panel, x, false, exact);
    exact_potential(panel, x - 1e-5 * panel.normal, false, low);
    exact_potential(panel, x + 1e-5 * panel.normal, false, high);
    EXPECT_LT((exact.dipole - (low.value - high.value) / 2e-5).norm(), 1e-5) << x.transpose();
  }
}

TEST(PanelPotential, FarRuleHoldsFromFiveRadiiOn) {
  const Panel panel = some_panel();
  std::mt19937 generator(1);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 200; ++i) {
    const Vec<3> direction = Vec<3>(normal(generator), normal(generator), normal(generator)).normalized();
    const Vec<3> x = panel.centre + 5 * panel.radius * direction;
    PanelPotential exact, far;
    exact_potential(panel, x, true, exact);
    far_potential(panel, x, true, far);
    EXPECT_LT((exact.value - far.value).norm(), 3e-6 * exact.value.norm());
    EXPECT_LT((exact.dipole - far.dipole).norm(), 1e-4 * exact.dipole.norm());
    for (size_t k = 0; k < 3; ++k) {
      EXPECT_LT((exact.gradient[k] - far.gradient[k]).norm(), 3e-5 * exact.gradient[k].norm());
      EXPECT_LT((exact.dipole_gradient[k] - far.dipole_gradient[k]).norm(), 3e-4 * exact.dipole_gradient[k].norm());
    }
  }
}

TEST(PanelPotential, InteractionsDoNotDependOnTheOrder) {
  const auto index = testing::make_index(testing::bent_prism());
  const auto panels = Panels::cut(structures_of(*index).cage, 200);
  for (size_t a = 0; a < panels->panels.size(); a += 7)
    for (size_t b = 0; b < panels->panels.size(); ++b) {
      const Mat<3> ab = panel_interaction(panels->panels[a], panels->panels[b]);
      const Mat<3> ba = panel_interaction(panels->panels[b], panels->panels[a]);
      // Integrated on the same side, but for panels of equal size.
      EXPECT_LT((ab - ba.transpose()).norm(), 5e-3 * ab.norm()) << a << " " << b;
    }
}

// -D[1] is one inside and zero outside, and -D[phi] sums to it: beside the cage too.
TEST(DoubleLayer, OfOneTellsInsideFromOutside) {
  for (const Shape& shape : {testing::box(), testing::bent_prism()}) {
    const auto index = testing::make_index(shape);
    const Cage<3>& cage = structures_of(*index).cage;
    const PanelKernels kernels(*Panels::cut(cage, 200));
    const DoubleLayer dipoles(cage, kernels.panels(), BoundaryData(cage, false));
    PanelKernels::Tables tables(kernels.point_count());
    for (const Panel& panel : kernels.panels().panels)
      for (const double height : {1e-9, 1e-4}) {
        kernels.fill(panel.point[0] - height * panel.normal, 0, false, true, tables);
        kernels.fill(panel.point[0] + height * panel.normal, 1, false, true, tables);
        DoubleLayer::Rows rows = DoubleLayer::Rows::Zero(4, cage.control_vertex_count());
        Eigen::Array4d enclosed = Eigen::Array4d::Zero();
        dipoles.add(tables.dipoles, rows, enclosed);
        EXPECT_NEAR(enclosed[0], 1, 1e-3);
        EXPECT_NEAR(enclosed[1], 0, 1e-3);
        EXPECT_NEAR(rows.row(0).sum(), enclosed[0], 1e-12);
        // Next to the panel the rows differ by the basis at its point.
        EXPECT_LT((rows.row(0) - rows.row(1) - dipoles.at(size_t(&panel - kernels.panels().panels.data()) * 3)).norm(),
                  height < 1e-6 ? 1e-6 : 2e-2);
      }
  }
}

TEST(TiledCholesky, Solves) {
  const Eigen::Index n = 250, padded = 288;
  std::mt19937 generator(2);
  std::normal_distribution<double> normal;
  const Eigen::MatrixXd root = Eigen::MatrixXd::NullaryExpr(n, n, [&] { return normal(generator); });
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Identity(padded, padded);
  matrix.topLeftCorner(n, n) = root * root.transpose() + Eigen::MatrixXd::Identity(n, n);
  TiledCholesky cholesky(n);
  const Eigen::Index tile = TiledCholesky::kTile;
  ASSERT_EQ(cholesky.tile_count() * static_cast<size_t>(tile), static_cast<size_t>(padded));
  for (size_t i = 0; i < cholesky.tile_count(); ++i)
    for (size_t j = 0; j <= i; ++j)
      cholesky.tile(i, j) = matrix.block(Eigen::Index(i) * tile, Eigen::Index(j) * tile, tile, tile);
  TiledCholesky::Columns wanted = TiledCholesky::Columns::Random(padded, 16), columns = matrix * wanted;
  while (!cholesky.is_factored()) cholesky.factor();
  EXPECT_EQ(cholesky.columns_raised(), 0u);
  for (size_t row = 0; row < cholesky.tile_count(); ++row) cholesky.forward(row, columns);
  for (size_t row = cholesky.tile_count(); row-- > 0;) cholesky.backward(row, columns);
  EXPECT_LT((columns - wanted).norm(), 1e-9 * wanted.norm());
}

// Largest and root-mean-square error over points of the cube [-1, 1]^3, where coordinates are trilinear.
struct BoxError {
  double worst = 0.0, rms = 0.0;
};

BoxError box_error(const Solution<3>& solution, const CageIndex& index, const std::vector<Vec<3>>& points) {
  SolvedRows<3> rows;
  std::vector<Vec<3>> normalized;
  for (const Vec<3>& x : points) normalized.push_back(structures_of(index).cage.frame().to_normalized(x));
  solution.evaluate(normalized, false, rows);
  BoxError error;
  for (size_t i = 0; i < points.size(); ++i)
    for (int v = 0; v < 8; ++v) {
      double expected = 1.0;
      for (int k = 0; k < 3; ++k) expected *= 0.5 * (1 + ((v >> (2 - k) & 1) != 0 ? points[i][k] : -points[i][k]));
      const double off = std::abs(rows.values(Eigen::Index(i), v) - expected);
      error.worst = std::max(error.worst, off);
      error.rms += off * off / static_cast<double>(points.size());
    }
  error.rms = std::sqrt(error.rms);
  return error;
}

std::vector<Vec<3>> points_in_box(size_t count, double reach, uint32_t seed) {
  const std::vector<double> values = testing::random_points(count, 3, -reach, reach, seed);
  std::vector<Vec<3>> points;
  for (size_t i = 0; i < count; ++i) points.emplace_back(values[3 * i], values[3 * i + 1], values[3 * i + 2]);
  return points;
}

// Everywhere, and next to faces, edges and corners.
TEST(BoundaryElements, AreTrilinearInABox) {
  const auto index = testing::make_index(testing::box());
  const auto solution = solve(*index, 1000, false);
  EXPECT_LT(box_error(*solution, *index, points_in_box(400, 1.0, 3)).worst, 5e-4);
  for (Eigen::Index close_faces = 1; close_faces <= 3; ++close_faces)
    for (const double distance : {3e-4, 3e-3, 3e-2}) {
      std::vector<Vec<3>> points = points_in_box(100, 1.0, 4);
      for (Vec<3>& x : points)
        for (Eigen::Index k = 0; k < close_faces; ++k) x[k] = 1 - distance * (1 + std::abs(x[k]));
      EXPECT_LT(box_error(*solution, *index, points).worst, 5e-4) << close_faces << ", " << distance;
    }
}

// The dipoles hold what is bilinear on the faces, and the density is smooth: order 3 and more, until the rules of the
// far panels show, at 1e-5.
TEST(BoundaryElements, ConvergeWithThePanels) {
  const auto index = testing::make_index(testing::box());
  const std::vector<Vec<3>> points = points_in_box(100, 0.7, 5);
  const auto error = [&](uint32_t panels) { return box_error(*solve(*index, panels, false), *index, points).rms; };
  const double coarse = error(24), middle = error(96), fine = error(384);
  EXPECT_GT(std::log(coarse / fine) / std::log(4.0), 3.0) << coarse << " -> " << fine;
  EXPECT_LT(middle, 2e-4);
  EXPECT_LT(fine, 4e-5);
}

// Where the cage bends inwards densities are infinite at the edge, like the power -1/3, and panels graded with power 2
// keep the order at 2 x 2 x 2/3, somewhat less in corners and on twisted patches. Against many panels, for there is no
// closed form.
TEST(BoundaryElements, ConvergeAtEdgesThatBendInwards) {
  const auto index = testing::make_index(testing::bent_prism());
  std::vector<Vec<3>> points;
  for (const Vec<3>& x : points_in_box(2000, 0.5, 6))
    if (structures_of(*index).winding->inside(x) && (*structures_of(*index).walks).closest(x).distance > 0.03)
      points.push_back(x);
  ASSERT_GT(points.size(), 50u);
  const auto rows = [&](uint32_t panels) {
    SolvedRows<3> result;
    solve(*index, panels, false)->evaluate(points, false, result);
    return result.values;
  };
  const auto best = rows(2000);
  const double coarse = (rows(60) - best).norm(), fine = (rows(540) - best).norm();
  EXPECT_GT(std::log(coarse / fine) / std::log(3.0), 2.0) << coarse << " -> " << fine;
}

// Green's representation holds linear functions exactly: no correction is needed for them.
TEST(BoundaryElements, InsideRowsAreNearlyLinearPrecise) {
  const auto index = testing::make_index(testing::bent_prism());
  const Cage<3>& cage = structures_of(*index).cage;
  const auto solution = solve(*index, 300, false);
  SolvedRows<3> rows;
  std::vector<Vec<3>> inside;
  for (const Vec<3>& x : points_in_box(400, 0.5, 6))
    if (structures_of(*index).winding->inside(x)) inside.push_back(x);
  solution->evaluate(inside, false, rows);
  for (size_t i = 0; i < inside.size(); ++i) {
    Vec<3> x = Vec<3>::Zero();
    for (uint32_t v = 0; v < cage.control_vertex_count(); ++v)
      x += rows.values(Eigen::Index(i), v) * cage.control_vertices()[v];
    EXPECT_LT((x - inside[i]).norm(), 1e-3);
    EXPECT_NEAR(rows.values.row(Eigen::Index(i)).sum(), 1, 1e-3);
  }
}

// Walks and boundary elements share nothing but the cage and the closest points. Inside, outside, closed and open: they
// differ by no more than the walks differ among themselves.
TEST(BoundaryElements, AreWhatWalksConvergeTo) {
  constexpr size_t kPoints = 16, kSeeds = 6;
  struct Case {
    Shape shape;
    double error = 0.002;  // of the panels, and the bias of the pseudo-samples
  };
  // The last two hold a part of themselves, and cut themselves: there one layer serves inside too. Panels do not
  // follow the cut.
  for (const auto& [shape, error] :
       {Case{testing::bent_prism()}, Case{testing::mixed_prism()}, Case{testing::open_box()}, Case{testing::soup()},
        Case{testing::joined(testing::box(), testing::small_box(0.1, 0.2, 0.0))},
        Case{testing::joined(testing::box(), testing::small_box(0.8, 0.7, 0.6)), 0.015}}) {
    const auto index = testing::make_index(shape);
    const QueryInput queries = testing::loose_points(testing::random_points(kPoints, 3, -1.6, 1.6, 6));
    const RowBlock solved = testing::bind_or_die(
        index, queries, {.estimator = Estimator::kBoundaryElement, .panels = 700, .prune_below = 0.0});
    std::vector<RowBlock> walked;
    for (uint64_t seed = 0; seed < kSeeds; ++seed)
      walked.push_back(
          testing::bind_or_die(index, queries, {.samples = 1500, .seed = seed, .thickness = 1e-4, .prune_below = 0.0}));
    double difference = 0.0, noise = 0.0;  // of the mean over seeds, squared, over all points
    for (size_t i = 0; i < kPoints; ++i) {
      const auto row = [&](const RowBlock& block) {
        const std::vector<double> dense = testing::dense_row(block, i, index->control_vertex_count());
        return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(dense.data(), Eigen::Index(dense.size())));
      };
      Eigen::VectorXd mean = Eigen::VectorXd::Zero(index->control_vertex_count());
      for (const RowBlock& block : walked) mean += row(block) / kSeeds;
      for (const RowBlock& block : walked) noise += (row(block) - mean).squaredNorm() / (kSeeds * (kSeeds - 1));
      difference += (row(solved) - mean).squaredNorm();
    }
    EXPECT_LT(difference, 1.6 * noise + kPoints * error * error);
    EXPECT_LT(noise / kPoints, 0.02 * 0.02);
  }
}

// From a face, an edge and a vertex, along some direction: the values' distance from the basis shrinks with the
// query's.
TEST(BoundaryElements, ApproachTheBasis) {
  for (const Shape& shape : {testing::bent_prism(), testing::open_box()}) {
    const auto index = testing::make_index(shape);
    const CageStructures<3>& structures = structures_of(*index);
    const auto solution = solve(*index, 300);
    const Element& element = structures.cage.elements()[1];
    for (const auto& shares : {std::array<double, 4>{0.1, 0.4, 0.4, 0.1}, {0.3, 0.7, 0, 0}, {1, 0, 0, 0}})
      for (const Vec<3>& direction :
           {Vec<3>(0.3, 0.5, 0.81).normalized().eval(), Vec<3>(-0.6, 0.3, -0.4).normalized().eval()}) {
        Vec<3> y = Vec<3>::Zero();
        std::vector<double> basis(index->control_vertex_count(), 0.0);
        for (size_t k = 0; k < 4; ++k) {
          y += shares[k] * structures.cage.corner(element, static_cast<int>(k));
          basis[element.node[k]] += shares[k];
        }
        std::vector<Vec<3>> points;
        for (int power = 2; power <= 12; ++power) points.push_back(y + std::pow(10.0, -power) * direction);
        points.push_back(y);
        SolvedRows<3> rows;
        solution->evaluate(points, true, rows);
        for (size_t i = 0; i < points.size(); ++i) {
          double off = 0.0;
          for (size_t v = 0; v < basis.size(); ++v)
            off = std::max(off, std::abs(rows.values(Eigen::Index(i), Eigen::Index(v)) - basis[v]));
          const double distance = (points[i] - y).norm();
          // At edges harmonic functions may rise like the power 2/3 of the distance, at vertices faster.
          EXPECT_LT(off, 30 * std::sqrt(distance) + 1e-7) << distance;
          EXPECT_TRUE(rows.gradients[0].row(Eigen::Index(i)).allFinite());
        }
      }
  }
}

TEST(BoundaryElements, GradientsAreThoseOfTheValues) {
  for (const Shape& shape : {testing::bent_prism(), testing::open_box()}) {
    const auto index = testing::make_index(shape);
    const auto solution = solve(*index, 300);
    std::vector<Vec<3>> points = points_in_box(20, 0.45, 7);
    points.emplace_back(3, -2, 1);
    SolvedRows<3> rows;
    solution->evaluate(points, true, rows);
    for (size_t i = 0; i < points.size(); ++i)
      for (Eigen::Index k = 0; k < 3; ++k) {
        const double h = 1e-6;
        const Vec<3> step = h * Vec<3>::Unit(k);
        SolvedRows<3> around;
        solution->evaluate(std::array<Vec<3>, 2>{points[i] - step, points[i] + step}, false, around);
        const auto difference = (around.values.row(1) - around.values.row(0)) / (2 * h);
        const auto& gradient = rows.gradients[static_cast<size_t>(k)].row(Eigen::Index(i));
        // Within a fifth of a panel of the cage the width of the correction's fading counts as constant.
        const double near = (*structures_of(*index).walks).closest(points[i]).distance;
        EXPECT_LT((difference - gradient).norm(),
                  near < 0.05 ? 0.05 * (1 + gradient.norm()) : 1e-4 * (1 + gradient.norm()))
            << points[i].transpose() << ", " << near << " from the cage";
      }
  }
}

TEST(BoundaryElements, KeepThePromises) {
  for (const Shape& shape : {testing::bent_prism(), testing::mixed_prism(), testing::open_box(), testing::soup()}) {
    const auto index = testing::make_index(shape);
    std::vector<double> points = testing::random_points(60, 3, -2, 2, 8);
    for (const double value : testing::random_points(10, 3, -1e4, 1e4, 9)) points.push_back(value);
    points.insert(points.end(), shape.vertices.begin(), shape.vertices.end());
    const Options options{.estimator = Estimator::kBoundaryElement, .panels = 200, .gradients = true};
    BindingSummary summary;
    const RowBlock block = testing::bind_or_die(index, testing::loose_points(points), options, &summary);
    EXPECT_LE(testing::promise_error<3>(*index, points, block).worst(), 1.0);
    EXPECT_EQ(summary.samples, 0u);
    EXPECT_GT(summary.solving_s, 0.0);
    EXPECT_GE(summary.rows_on_cage, shape.vertex_count());
  }
}

// Flat panels lie on either side of the patch that they were cut from: from the patch inwards a line crosses some of
// them, where dipoles jump.
TEST(BoundaryElements, InsideNothingJumpsBelowTwistedQuads) {
  for (const Shape& shape : {testing::bent_prism(), testing::sphere(7, 1.0)}) {
    const auto index = testing::make_index(shape);
    const CageStructures<3>& structures = structures_of(*index);
    const auto solution = solve(*index, shape.quads.size() < 100 ? 100 : 400, false);
    const double step = 1e-4;
    size_t steps = 0;
    for (uint32_t e = 0; e < structures.cage.elements().size(); e += 3)
      for (const auto& at : {Vec<2>(0.2, 0.3), Vec<2>(0.5, 0.85), Vec<2>(0.76, 0.41)}) {
        const Element& element = structures.cage.elements()[e];
        if (element.kind != ElementKind::kQuad) continue;
        const BilinearPatch patch = patch_of(structures.cage, element);
        const Vec<3> inward =
            -structures.cage.orientation() * element_normal(structures.cage, element, patch.shares(at[0], at[1]));
        std::vector<Vec<3>> points;
        for (int i = 1; i < 200; ++i) points.push_back(patch.at(at[0], at[1]) + i * step * inward);
        if (!std::all_of(points.begin(), points.end(), [&](const auto& x) { return structures.winding->inside(x); }))
          continue;
        SolvedRows<3> rows;
        solution->evaluate(points, false, rows);
        for (Eigen::Index i = 1; i < rows.values.rows(); ++i, ++steps)
          EXPECT_LT((rows.values.row(i) - rows.values.row(i - 1)).norm(), 40 * step) << e << ", step " << i;
      }
    EXPECT_GT(steps, 1000u);
  }
}

// On the cage and below it, without the final correction, on either side of the panels; but not on their edges, where
// slopes in the plane are infinite.
TEST(BoundaryElements, InsideGradientsReproducePositionNextToTheCage) {
  const auto index = testing::make_index(testing::bent_prism());
  const CageStructures<3>& structures = structures_of(*index);
  const Cage<3>& cage = structures.cage;
  const auto solution = solve(*index, 300, false);
  for (const double depth : {0.0, 1e-4, 1e-3}) {
    std::vector<Vec<3>> points;
    for (const Element& element : cage.elements())
      for (const auto& at : {Vec<2>(0.21, 0.32), Vec<2>(0.57, 0.81), Vec<2>(0.72, 0.43)}) {
        const BilinearPatch patch = patch_of(cage, element);
        const Vec<3> normal = element_normal(cage, element, patch.shares(at[0], at[1]));
        points.push_back(patch.at(at[0], at[1]) - depth * cage.orientation() * normal);
      }
    SolvedRows<3> rows;
    solution->evaluate(points, true, rows);
    double squared = 0.0;
    for (size_t i = 0; i < points.size(); ++i) {
      Mat<3> jacobian = -Mat<3>::Identity();
      for (Eigen::Index k = 0; k < 3; ++k)
        for (uint32_t v = 0; v < cage.control_vertex_count(); ++v)
          jacobian.row(k) +=
              rows.gradients[static_cast<size_t>(k)](Eigen::Index(i), v) * cage.control_vertices()[v].transpose();
      squared += jacobian.squaredNorm() / static_cast<double>(points.size());
    }
    EXPECT_LT(std::sqrt(squared), 0.12) << depth;
  }
}

// Corners in one place leave panels without area.
TEST(BoundaryElements, QuadsWithTwoCornersInOnePlaceAreTriangles) {
  const auto quads = testing::make_index(testing::collapsed_box());
  const auto solution = solve(*quads, 600, false);
  const auto triangles = testing::make_index(testing::triangulated(testing::box()));
  SolvedRows<3> of_quads, of_triangles;
  std::vector<Vec<3>> points;
  for (const Vec<3>& x : points_in_box(100, 0.9, 3))
    points.push_back(structures_of(*quads).cage.frame().to_normalized(x));
  solution->evaluate(points, false, of_quads);
  solve(*triangles, 600, false)->evaluate(points, false, of_triangles);
  EXPECT_LT((of_quads.values - of_triangles.values).cwiseAbs().maxCoeff(), 0.01);
}

// A row is a function of its point: alone, in any batch, over threads.
TEST(BoundaryElements, RowsDoNotDependOnOtherPoints) {
  const auto index = testing::make_index(testing::bent_prism());
  const auto solution = solve(*index, 200);
  const std::vector<Vec<3>> points = points_in_box(37, 0.6, 10);
  for (const bool gradients : {false, true}) {
    SolvedRows<3> all, one;
    solution->evaluate(points, gradients, all);
    for (size_t i = 0; i < points.size(); ++i) {
      solution->evaluate(std::span(points).subspan(i, 1), gradients, one);
      EXPECT_EQ(one.values.row(0), all.values.row(Eigen::Index(i)));
      if (gradients) {
        EXPECT_EQ(one.gradients[2].row(0), all.gradients[2].row(Eigen::Index(i)));
      }
    }
  }
}

// Moments are solved for only where a point needs them; it must not show in the others.
TEST(BoundaryElements, RowsInsideDoNotKnowOfPointsOutside) {
  const auto index = testing::make_index(testing::box());
  const Options options{.estimator = Estimator::kBoundaryElement, .panels = 200};
  const RowBlock alone = testing::bind_or_die(index, testing::loose_points({0.1, 0.2, 0.3}), options);
  const RowBlock together = testing::bind_or_die(index, testing::loose_points({0.1, 0.2, 0.3, 2, 2, 2}), options);
  for (size_t v = 0; v < 8; ++v) EXPECT_EQ(alone.values[v], together.values[v]);
}

// On acute edges a step straight inwards from one face leads out through the other.
TEST(BoundaryElements, PointsOnEdgesAndVerticesAloneHaveFiniteGradients) {
  for (const Shape& shape : {testing::tetrahedron(), testing::bent_prism(), testing::open_box(),
                             testing::flat_tetrahedron(), testing::thin_box()}) {
    const bool thin = shape.vertex_count() == 4 || shape.vertices[2] > -0.5;
    const auto index = testing::make_index(shape);
    std::vector<double> points = shape.vertices;
    for (size_t v = 3; v < shape.vertices.size(); v += 3)
      for (const double t : {0.25, 0.5, 0.9})
        for (size_t k = 0; k < 3; ++k) points.push_back((1 - t) * shape.vertices[k] + t * shape.vertices[v + k]);
    const Options options{.estimator = Estimator::kBoundaryElement, .panels = 64, .gradients = true};
    for (size_t i = 0; i < points.size(); i += 3) {
      const std::vector<double> one(points.begin() + long(i), points.begin() + long(i) + 3);
      const RowBlock block = testing::bind_or_die(index, testing::loose_points(one), options);
      EXPECT_LE(testing::promise_error<3>(*index, one, block).worst(), 1.0);
      // Steep outside of a coarse cage; 26 is the largest seen.
      for (const double g : block.gradients) EXPECT_LT(std::abs(g), thin ? 1e6 : 50.0);
    }
  }
}

TEST(BoundaryElements, RowsDoNotDependOnThreadsAndBlocks) {
  const auto index = testing::make_index(testing::bent_prism());
  const auto options = *resolve({.estimator = Estimator::kBoundaryElement, .panels = 200, .gradients = true}, false);
  const QueryInput queries = testing::loose_points(testing::random_points(50, 3, -1, 2, 12));
  std::vector<double> expected;
  for (const int threads : {1, 2, 7}) {
    tbb::task_arena arena(threads);
    for (const uint32_t block_rows : {7u, 64u}) {
      std::vector<double> values;
      arena.execute([&] {
        auto binding = Binding::create(index, queries, {.options = options, .block_rows = block_rows, .first_row = 5});
        for (;;) {
          const Binding::Step step = (*binding)->advance(kNeverCancelled);
          if (step == Binding::Step::kDone) break;
          if (step != Binding::Step::kBlock) continue;
          const RowBlock block = (*binding)->take_block();
          values.insert(values.end(), block.values.begin(), block.values.end());
        }
      });
      if (expected.empty()) expected = values;
      EXPECT_EQ(values, expected);
    }
  }
}

// Unused control vertices cost nothing and have no entries.
TEST(BoundaryElements, UnusedVerticesAreLeftOut) {
  Shape shape = testing::box();
  const QueryInput query = testing::loose_points({0.1, 0.2, 2.3});
  const Options options{.estimator = Estimator::kBoundaryElement, .panels = 100};
  const RowBlock plain = testing::bind_or_die(testing::make_index(shape), query, options);
  shape.vertices.insert(shape.vertices.begin(), {7, 7, 7});
  shape.vertices.insert(shape.vertices.end(), {8, 8, 8});
  for (uint32_t& v : shape.quads) ++v;
  const RowBlock more = testing::bind_or_die(testing::make_index(shape), query, options);
  EXPECT_EQ(plain.values, more.values);
  for (size_t i = 0; i < plain.indices.size(); ++i) EXPECT_EQ(plain.indices[i] + 1, more.indices[i]);
}

TEST(BoundaryElements, StopWhenCancelled) {
  const auto index = testing::make_index(testing::bent_prism());
  const auto options = *resolve({.estimator = Estimator::kBoundaryElement, .panels = 200}, false);
  for (int steps = 0; steps < 40; steps += 3) {
    auto binding =
        Binding::create(index, testing::loose_points(testing::random_points(500, 3, -1, 2, 12)), {.options = options});
    std::atomic<bool> cancel = false;
    Binding::Step step = Binding::Step::kWorking;
    for (int i = 0; i < steps && step != Binding::Step::kDone; ++i) step = (*binding)->advance(cancel);
    cancel = true;
    EXPECT_EQ((*binding)->advance(cancel), Binding::Step::kCancelled);
  }
}

TEST(BoundaryElements, ElementsOnTopOfEachOtherAreEndured) {
  Shape doubled = testing::box();
  const std::vector<uint32_t> quads = doubled.quads;
  doubled.quads.insert(doubled.quads.end(), quads.begin(), quads.end());
  const auto index = testing::make_index(doubled), plain = testing::make_index(testing::box());
  const QueryInput queries = testing::loose_points(testing::random_points(20, 3, -0.8, 0.8, 11));
  const Options options{.estimator = Estimator::kBoundaryElement, .panels = 400};
  const RowBlock two = testing::bind_or_die(index, queries, options),
                 one = testing::bind_or_die(plain, queries, options);
  for (size_t i = 0; i < 20; ++i) {
    const auto a = testing::dense_row(two, i, 8), b = testing::dense_row(one, i, 8);
    for (size_t v = 0; v < 8; ++v) EXPECT_NEAR(a[v], b[v], 5e-3);
  }
}

TEST(BoundaryElements, RefuseWhatTheyCannotDo) {
  const auto error_of = [](const Shape& shape, const Options& options) -> Error {
    const auto resolved = resolve(options, false);
    if (!resolved) return resolved.error();
    const auto binding = Binding::create(testing::make_index(shape), testing::loose_points(std::vector<double>(6, 0.1)),
                                         {.options = *resolved});
    return binding.ok() ? Error{} : binding.error();
  };
  using enum Estimator;
  EXPECT_EQ(error_of(testing::square(), {.estimator = kBoundaryElement}).field, "estimator");
  EXPECT_EQ(error_of(testing::sphere(12, 1), {.estimator = kBoundaryElement, .panels = 100}).field, "panels");
  EXPECT_EQ(error_of(testing::box(), {.coordinates = CoordinateKind::kMeanValue, .estimator = kBoundaryElement}).field,
            "estimator");
  EXPECT_EQ(error_of(testing::box(), {.coordinates = CoordinateKind::kMeanValue, .estimator = kExact}).field,
            "estimator");
  EXPECT_EQ(error_of(testing::box(), {.preset = Preset::kPaper, .estimator = kBoundaryElement}).field, "estimator");
  EXPECT_EQ(error_of(testing::box(), {.estimator = kBoundaryElement, .samples = 50}).field, "samples");
  EXPECT_EQ(error_of(testing::box(), {.estimator = kBoundaryElement, .panels = 5000}).field, "panels");
  EXPECT_EQ(error_of(testing::box(), {.panels = 500}).field, "panels");
  EXPECT_EQ(error_of(testing::box(), {.estimator = kBoundaryElement, .thickness = 1e-3}).field, "thickness");
  EXPECT_EQ(error_of(testing::box(), {.estimator = kBoundaryElement, .walk_steps_max = 9}).field, "walk_steps_max");
  EXPECT_EQ(error_of(testing::box(), {.estimator = kBoundaryElement, .smoothing_time = 0.1}).field, "denoise");
  EXPECT_EQ(error_of(testing::box(), {.estimator = kBoundaryElement}).field, "");
}

}  // namespace
}  // namespace barycast
