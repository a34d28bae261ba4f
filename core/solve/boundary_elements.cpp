#include "solve/boundary_elements.h"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "base/parallel.h"
#include "solve/closed.h"
#include "solve/cuts.h"
#include "solve/panel_potential.h"

namespace barycast {
namespace {

// Whether potentials of dipoles, which jump across the cage, can be told apart from those of the other side.
bool has_two_sides(const Cage<3>& cage) {
  if (!is_closed(cage)) return false;
  const std::vector<uint8_t> cut = cut_elements(cage);
  return std::find(cut.begin(), cut.end(), 1) == cut.end();
}

constexpr size_t kTile = static_cast<size_t>(TiledCholesky::kTile);
constexpr size_t kPanelsPerTile = kTile / 3;
static_assert(kTile % 3 == 0);
// Tiles that a thread assembles at a time: a millisecond each, several where all panels are close to each other.
constexpr size_t kTilesAtOnce = 4;

// Products of a tile with a group, that a thread does at a time: 0.3 million operations each.
constexpr size_t kRowProducts = 700;

// Pairs of panels whose dipoles are evaluated by a thread at a time.
constexpr size_t kDipolePairs = 200'000;
// A point of the cage that has a solid angle other than half of space has another part of the cage about it. Panels
// that stand for three points are off by thousandths.
constexpr double kHalfSpace = 0.05;

// On the diagonal of the scaled matrix, whose entries are about one: elements on top of each other get the mean of
// their boundary values instead of no solution; the others change by less than the discretization a million times.
constexpr double kRegularization = 1e-10;

// Unknowns are scaled so that the matrix does not grow with the panels' size.
double unknown_scale(const Panel& panel) {
  return std::pow(panel.area, -0.75);
}

}  // namespace

Result<std::unique_ptr<BoundarySolver>> BoundarySolver::create(const Cage<3>& cage, const BoundarySettings& settings) {
  Result<Panels> panels = Panels::cut(cage, settings.panels);
  if (!panels) return panels.error();
  return std::unique_ptr<BoundarySolver>(new BoundarySolver(cage, std::move(*panels), settings.sides));
}

BoundarySolver::BoundarySolver(const Cage<3>& cage, Panels panels, BoundarySides sides)
    : cage_(cage),
      kernels_(std::move(panels)),
      data_(cage, sides != BoundarySides::kInside),
      dipoles_(cage, kernels_.panels(), data_),
      matrix_(3 * kernels_.panels().panels.size()) {
  const bool inside = sides != BoundarySides::kElsewhere && has_two_sides(cage);
  if (inside) densities_.inside.resize(DensityColumn::groups(data_.basis_count()));
  if (sides != BoundarySides::kInside || !inside) densities_.indirect.resize(DensityColumn::groups(data_));
  dipoles_done_ = inside ? 0 : BoundarySolver::panels().size();
}

size_t BoundarySolver::total() const {
  return panels().size() + tiles() + rows() + 2 * rows() * groups();
}

size_t BoundarySolver::solved_bytes(const BoundarySettings& settings, size_t control_vertices) {
  const auto n = static_cast<Eigen::Index>(control_vertices);
  // Inside, and with moments both sides; in whole groups each.
  size_t groups = DensityColumn::groups(n);
  if (settings.sides != BoundarySides::kInside) groups += DensityColumn::groups(n) + DensityColumn::groups(3 * n + 6);
  const size_t per_point = groups * static_cast<size_t>(kDensityGroup) + 11;  // and kernels, and shares
  return settings.panels * (sizeof(Panel) + 3 * per_point * sizeof(double));
}

size_t BoundarySolver::bytes(const BoundarySettings& settings, size_t control_vertices) {
  return TiledCholesky::bytes(3 * static_cast<size_t>(settings.panels)) + solved_bytes(settings, control_vertices);
}

TiledCholesky::Columns& BoundarySolver::group(size_t g) {
  return g < densities_.inside.size() ? densities_.inside[g] : densities_.indirect[g - densities_.inside.size()];
}

// Boundary values that the dipoles leave to the single layer: what they are on the cage as seen from inside, taken
// off at the points of the panels, whose rule integrates them. False: there is more of the cage about a point.
bool BoundarySolver::subtract_dipoles(size_t p, PanelKernels::Tables& kernels) {
  const Panel& panel = panels()[p];
  for (size_t k = 0; k < 3; ++k) kernels_.fill(panel.point[k], static_cast<Eigen::Index>(k), false, true, kernels);
  // A flat panel's own are the same but for their sign on both sides: none in between.
  kernels.dipoles.middleCols<3>(static_cast<Eigen::Index>(3 * p)).setZero();
  DoubleLayer::Rows values = DoubleLayer::Rows::Zero(4, data_.basis_count());
  Eigen::Array4d enclosed = Eigen::Array4d::Zero();
  dipoles_.add(kernels.dipoles, values, enclosed);
  const double weight = panel.area / 3 * unknown_scale(panel);
  for (size_t k = 0; k < 3; ++k) {
    const auto at = static_cast<Eigen::Index>(k);
    if (!(std::abs(enclosed[at] - 0.5) < kHalfSpace)) return false;
    // Half of the own values, and so that constants come out exactly whatever the quadrature: as much as is missing.
    const BoundaryData::Row inside = values.row(at) + (1 - enclosed[at]) * dipoles_.at(3 * p + k);
    for (Eigen::Index v = 0; v < inside.size(); ++v) {
      const DensityColumn column(v, data_);
      densities_.inside[column.group](static_cast<Eigen::Index>(3 * p + k), column.lane) = -weight * inside[v];
    }
  }
  return true;
}

void BoundarySolver::subtract_dipoles() {
  if (dipoles_done_ == 0)
    for (auto& columns : densities_.inside) columns.setZero(static_cast<Eigen::Index>(rows() * kTile), kDensityGroup);
  const size_t first = dipoles_done_, at_once = 1 + kDipolePairs / (3 * panels().size());
  const size_t count = std::min(panels().size() - first, at_once * parallel_width());
  std::atomic<bool> embedded = true;
  parallel_for(count, at_once, [&](size_t begin, size_t end) {
    PanelKernels::Tables kernels(kernels_.point_count());
    for (size_t p = first + begin; p < first + end && embedded; ++p)
      if (!subtract_dipoles(p, kernels)) embedded = false;
  });
  dipoles_done_ += count;
  if (embedded) return;
  dipoles_done_ = panels().size();
  densities_.inside.clear();
  if (densities_.indirect.empty()) densities_.indirect.resize(DensityColumn::groups(data_));
}

void BoundarySolver::assemble() {
  const size_t first = assembled_, count = std::min(tiles() - first, kTilesAtOnce * parallel_width());
  parallel_for(count, 1, [&](size_t begin, size_t end) {
    for (size_t at = first + begin; at < first + end; ++at) {
      auto row = static_cast<size_t>((std::sqrt(8.0 * static_cast<double>(at) + 1.0) - 1.0) / 2.0);
      while (row * (row + 1) / 2 > at) --row;
      while ((row + 1) * (row + 2) / 2 <= at) ++row;
      assemble_tile(row, at - row * (row + 1) / 2);
    }
  });
  assembled_ += count;
}

void BoundarySolver::assemble_tile(size_t row, size_t column) {
  const auto& panels = BoundarySolver::panels();
  TiledCholesky::Tile tile = matrix_.tile(row, column);
  tile.setZero();
  for (size_t i = 0; i < kPanelsPerTile; ++i) {
    const size_t a = row * kPanelsPerTile + i;
    const auto at_row = static_cast<Eigen::Index>(3 * i);
    if (a >= panels.size()) {
      if (row == column) tile.block<3, 3>(at_row, at_row).setIdentity();
      continue;
    }
    for (size_t j = 0; j < kPanelsPerTile && column * kPanelsPerTile + j <= a; ++j) {
      const size_t b = column * kPanelsPerTile + j;
      Mat<3> block = panel_interaction(panels[a], panels[b]);
      // By quadrature on one side the interaction of a panel with itself is symmetric only nearly.
      if (a == b) block = 0.5 * (block + block.transpose()).eval();
      block *= unknown_scale(panels[a]) * unknown_scale(panels[b]);
      if (a == b) block += kRegularization * Mat<3>::Identity();
      tile.block<3, 3>(at_row, static_cast<Eigen::Index>(3 * j)) = block;
    }
  }
}

// To every column of the groups, what is known on the cage, integrated with the panels' functions.
void BoundarySolver::add_boundary_values(DensityGroups& groups) {
  for (auto& columns : groups)
    if (columns.size() == 0) columns.setZero(static_cast<Eigen::Index>(rows() * kTile), kDensityGroup);
  std::vector<BoundaryData::Entry> entries;
  for (size_t p = 0; p < panels().size(); ++p) {
    const Panel& panel = panels()[p];
    const Element& element = cage_.elements()[panel.element];
    for (const TrianglePoint& rule : kTriangleRule) {
      const auto shares = element_shares(element.kind, panel, rule.barycentric);
      const Vec<3> y = point_at(cage_, element, shares);
      data_.entries(panel.element, shares, y, entries);
      for (size_t k = 0; k < 3; ++k) {
        const double weight = rule.weight * panel.area * (2 * rule.barycentric[k] - 1 / 3.0) * unknown_scale(panel);
        for (const BoundaryData::Entry& entry : entries) {
          const DensityColumn at(entry.column, data_);
          if (at.group < groups.size())
            groups[at.group](static_cast<Eigen::Index>(3 * p + k), at.lane) += weight * entry.value;
        }
      }
    }
  }
}

// As many groups as there are threads, some rows of tiles at a time.
void BoundarySolver::solve_groups() {
  if (solved_ == 0 && rows_solved_ == 0) {
    add_boundary_values(densities_.inside);
    add_boundary_values(densities_.indirect);
  }
  const size_t first_group = solved_ / (2 * rows()), count = std::min(groups() - first_group, parallel_width());
  const size_t first = rows_solved_, end_row = std::min(2 * rows(), first + 1 + kRowProducts / rows());
  parallel_for(count, 1, [&](size_t begin, size_t end) {
    for (size_t g = first_group + begin; g < first_group + end; ++g)
      for (size_t row = first; row < end_row; ++row)
        row < rows() ? matrix_.forward(row, group(g)) : matrix_.backward(2 * rows() - 1 - row, group(g));
  });
  rows_solved_ = end_row;
  if (end_row < 2 * rows()) return;
  for (size_t g = first_group; g < first_group + count; ++g)
    for (size_t p = 0; p < panels().size(); ++p)
      group(g).middleRows<3>(static_cast<Eigen::Index>(3 * p)) *= unknown_scale(panels()[p]);
  solved_ += 2 * rows() * count;
  rows_solved_ = 0;
}

void BoundarySolver::advance() {
  if (dipoles_done_ < panels().size()) {
    subtract_dipoles();
  } else if (assembled_ < tiles()) {
    assemble();
  } else if (!matrix_.is_factored()) {
    matrix_.factor();
  } else {
    solve_groups();
  }
}

std::vector<Warning> BoundarySolver::warnings() const {
  if (matrix_.columns_raised() == 0) return {};
  return {{"cage",
           "elements cut each other or lie closer together than boundary elements can tell apart; coordinates may be "
           "off by some hundredths; sampling has no such limit"}};
}

BoundaryParts BoundarySolver::take_parts() {
  BARYCAST_CHECK_OP(done(), ==, total());
  return {std::move(kernels_), std::move(dipoles_), data_, std::move(densities_)};
}

std::unique_ptr<const Solution<3>> BoundarySolver::take(const DistanceIndex<3>& distance,
                                                        const WindingNumber<3>& winding) {
  return std::make_unique<BoundaryField>(cage_, distance, winding, take_parts());
}

}  // namespace barycast
