#include "solve/prediction.h"

#include <algorithm>
#include <string>

#include "base/parallel.h"
#include "solve/cuts.h"
#include "solve/panel_jump.h"

namespace barycast {
namespace {

// Panels: at least, and for every triangle that the elements are. After correction more of them hardly pay:
// FireHydrant's cage of 46 quads, 12 walks, E .0016 with 300 and with 600.
constexpr size_t kPanelsLeast = 300, kPanelsPerTriangle = 2;
// Of the table of what is missing, in all. FireHydrant: E .0023 with 3,000, .0021 with 6,000, .0016 with 12,000, .0015
// with 24,000, at 5 to 10 microseconds each. Gradients near the cage want more: what any number of walks is off by, at
// 0.0025 from an 88-vertex cage, is .08 of their size with 12,000 and .05 with 20,000. Moments have no gradients from
// it, and four times as many columns: their table has less where it would hold more numbers than that, down to the
// least that elements have.
constexpr size_t kNodesInside = 20'000, kNodesElsewhere = 12'000, kNumbersElsewhere = 4'400'000;
constexpr size_t kNodesPerTask = 64;
// How far off that table may be between its nodes, by its own account, before the missing is evaluated instead. Next to
// edges it is off by some hundredths, where few walks end: evaluated there they would take up to ten times as long, and
// E would not change. Where elements cut each other it is off by as much as coordinates are; points next to the cut of
// two boxes were still off by .18 with 4e-2, by .001 with 4e-3.
// Between two walls .0144 diagonals apart E of 10,000 walks was .015 with 8e-2, .003 with 4e-3.
constexpr double kRough = 8e-2, kRoughOfCut = 4e-3;

size_t nodes_wanted(bool inside, size_t columns) {
  return inside ? kNodesInside : std::min(kNodesElsewhere, kNumbersElsewhere / columns);
}

uint32_t panels_wanted(size_t triangles) {
  return static_cast<uint32_t>(std::max(kPanelsLeast, kPanelsPerTriangle * triangles));
}

uint32_t panels_wanted(const Cage<3>& cage) {
  return panels_wanted(cage.surface_triangles());
}

HarmonicPrediction::CageSize within_limits(const HarmonicPrediction::CageSize& cage) {
  return {std::clamp<size_t>(cage.elements, 1, HarmonicPrediction::kTrianglesMost),
          std::min<size_t>(cage.triangles, HarmonicPrediction::kTrianglesMost),
          std::min<size_t>(cage.control_vertices, HarmonicPrediction::kVerticesMost)};
}

size_t columns_of(const HarmonicPrediction::CageSize& cage, BoundarySides side) {
  return side == BoundarySides::kInside ? cage.control_vertices : 4 * cage.control_vertices + 6;
}

}  // namespace

Status HarmonicPrediction::check(uint64_t surface_triangles, uint64_t control_vertices) {
  if (surface_triangles <= kTrianglesMost && control_vertices <= kVerticesMost) return Done{};
  return invalid_argument("estimator", "the cage is too large to be predicted: " + std::to_string(kTrianglesMost) +
                                           " triangles (quads count twice) and " + std::to_string(kVerticesMost) +
                                           " control vertices are the most");
}

Result<std::unique_ptr<const HarmonicPrediction>> HarmonicPrediction::create(const Cage<3>& cage,
                                                                             const DistanceIndex<3>& distance,
                                                                             BoundarySides side) {
  auto solver = BoundarySolver::create(cage, {.panels = panels_wanted(cage), .sides = side});
  if (!solver) return solver.error();
  while ((*solver)->done() < (*solver)->total()) (*solver)->advance();
  return of(cage, distance, (*solver)->take_parts());
}

std::unique_ptr<const HarmonicPrediction> HarmonicPrediction::of(const Cage<3>& cage, const DistanceIndex<3>& distance,
                                                                 BoundaryParts parts) {
  std::unique_ptr<HarmonicPrediction> prediction(new HarmonicPrediction(cage, distance, std::move(parts)));
  prediction->find_missing();
  return prediction;
}

HarmonicPrediction::HarmonicPrediction(const Cage<3>& cage, const DistanceIndex<3>& distance, BoundaryParts parts)
    : cage_(cage),
      distance_(distance),
      parts_(std::move(parts)),
      sums_(parts_.kernels.panels(), parts_.data, has_dipoles() ? parts_.densities.inside : parts_.densities.indirect,
            has_dipoles() ? &parts_.dipoles : nullptr),
      missing_(cage, static_cast<size_t>(columns()), nodes_wanted(has_dipoles(), static_cast<size_t>(columns()))) {
  if (has_dipoles() && LocalExpansions::hold(sums_, parts_.kernels.panels()))
    expansions_.emplace(sums_, parts_.kernels.panels());
}

void HarmonicPrediction::find_missing() {
  parallel_for(missing_.node_count(), kNodesPerTask, [&](size_t begin, size_t end) {
    std::vector<ResidualTable::Node> nodes;
    for (size_t i = begin; i < end; ++i) nodes.push_back(missing_.node(i));
    Rows::Table found;
    evaluate_missing(nodes, found);
    for (size_t i = begin; i < end; ++i)
      std::copy_n(found.row(static_cast<Eigen::Index>(i - begin)).data(), columns(), missing_.row(i).data());
  });
  std::vector<double> tolerance(cage_.elements().size(), kRough);
  if (!has_dipoles()) {  // which cages that cut themselves do not have
    const std::vector<uint8_t> cut = cut_elements(cage_), close = close_elements(cage_);
    std::transform(cut.begin(), cut.end(), close.begin(), tolerance.begin(),
                   [](uint8_t is_cut, uint8_t is_close) { return is_cut + is_close > 0 ? kRoughOfCut : kRough; });
  }
  missing_.find_rough(tolerance);
}

void HarmonicPrediction::evaluate_missing(std::span<const ResidualTable::Node> on_cage, Rows::Table& missing) const {
  std::vector<ResidualTable::Node> at;
  std::vector<Vec<3>> points;
  for (const auto& [element, shares] : on_cage) {
    at.push_back(missing_.inset(element, shares));
    points.push_back(point_at(cage_, cage_.elements()[element], at.back().shares));
  }
  Rows rows;
  sums_.evaluate(points, columns(), false, rows);
  missing.resize(rows.values.rows(), columns());
  BoundaryData::Row exact(columns());
  for (size_t k = 0; k < at.size(); ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    continue_beyond_panels({0.0, at[k].element, at[k].shares, points[k]}, points[k], k, false, rows);
    parts_.data.values(at[k].element, at[k].shares, points[k], exact);
    missing.row(row) = (exact - rows.values.row(row).cast<double>()).cast<float>();
  }
}

void HarmonicPrediction::continue_beyond_panels(const CagePoint<3>& y, const Vec<3>& x, size_t row, bool gradients,
                                                Rows& rows) const {
  if (!has_dipoles()) return;
  const double outside = outside_part(double{rows.enclosed[row]});
  if (outside == 0.0) return;
  const auto jump = jump_across_panel(parts_.kernels.panels(), parts_.dipoles, parts_.densities.inside, parts_.data,
                                      cage_.orientation(), y, x);
  if (!jump) return;
  const auto at = static_cast<Eigen::Index>(row);
  rows.values.row(at) += (outside * jump->value).cast<float>();
  for (size_t k = 0; gradients && k < 3; ++k) rows.gradients[k].row(at) += (outside * jump->gradient[k]).cast<float>();
}

bool HarmonicPrediction::evaluate(std::span<const Vec<3>> points, bool gradients, const std::atomic<bool>& cancel,
                                  Rows& out) const {
  if (!expansions_)
    sums_.evaluate(points, columns(), gradients, out);
  else if (!expansions_->evaluate(points, gradients, cancel, out))
    return false;
  if (!has_dipoles()) return true;
  for (size_t i = 0; i < points.size(); ++i)
    if (outside_part(double{out.enclosed[i]}) > 0.0)
      continue_beyond_panels(distance_.closest(points[i]), points[i], i, gradients, out);
  return true;
}

size_t HarmonicPrediction::bytes(const CageSize& size, BoundarySides side) {
  const CageSize cage = within_limits(size);
  const size_t panels = panels_wanted(cage.triangles), columns = columns_of(cage, side);
  const size_t nodes = nodes_wanted(side == BoundarySides::kInside, columns);
  return BoundarySolver::solved_bytes({.panels = static_cast<uint32_t>(panels), .sides = side}, cage.control_vertices) +
         PanelSums::bytes(panels, columns) + ResidualTable::node_count(cage.elements, nodes) * columns * sizeof(float);
}

size_t HarmonicPrediction::solving_bytes(const CageSize& size, BoundarySides side) {
  const CageSize cage = within_limits(size);
  return bytes(cage, side) + TiledCholesky::bytes(3 * static_cast<size_t>(panels_wanted(cage.triangles)));
}

size_t HarmonicPrediction::bytes() const {
  return sizeof(*this) + parts_.kernels.bytes() + parts_.dipoles.bytes() +
         static_cast<size_t>(parts_.kernels.point_count()) * kDensityGroup *
             (parts_.densities.inside.size() + parts_.densities.indirect.size()) * sizeof(double) +
         sums_.bytes() + (expansions_ ? expansions_->bytes() : 0) + missing_.bytes();
}

}  // namespace barycast
