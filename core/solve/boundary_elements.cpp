#include "solve/boundary_elements.h"

#include <algorithm>
#include <cmath>

#include "base/parallel.h"
#include "solve/panel_potential.h"

namespace barycast {
namespace {

constexpr size_t kTile = static_cast<size_t>(TiledCholesky::kTile);
constexpr size_t kPanelsPerTile = kTile / 3;
static_assert(kTile % 3 == 0);
// Tiles that a thread assembles at a time: a millisecond each, several where all panels are close to each other.
constexpr size_t kTilesAtOnce = 4;

// Products of a tile with a group, that a thread does at a time: 0.3 million operations each.
constexpr size_t kRowProducts = 700;

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
  return std::unique_ptr<BoundarySolver>(new BoundarySolver(cage, std::move(*panels), settings.moments));
}

BoundarySolver::BoundarySolver(const Cage<3>& cage, Panels panels, bool moments)
    : cage_(cage),
      panels_(std::move(panels)),
      data_(cage, moments),
      matrix_(3 * panels_.panels.size()),
      densities_(DensityColumn::groups(data_)) {}

size_t BoundarySolver::solved_bytes(const BoundarySettings& settings, size_t control_vertices) {
  const size_t columns = settings.moments ? 4 * control_vertices + 6 : control_vertices;
  return settings.panels * (sizeof(Panel) + 3 * (columns + 16) * sizeof(double));
}

size_t BoundarySolver::bytes(const BoundarySettings& settings, size_t control_vertices) {
  return TiledCholesky::bytes(3 * static_cast<size_t>(settings.panels)) + solved_bytes(settings, control_vertices);
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
  const auto& panels = panels_.panels;
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

void BoundarySolver::set_boundary_values() {
  for (auto& group : densities_) group.setZero(static_cast<Eigen::Index>(rows() * kTile), kDensityGroup);
  std::vector<BoundaryData::Entry> entries;
  for (size_t p = 0; p < panels_.panels.size(); ++p) {
    const Panel& panel = panels_.panels[p];
    const Element& element = cage_.elements()[panel.element];
    for (const TrianglePoint& rule : kTriangleRule) {
      const auto shares = element_shares(element.kind, panel, rule.barycentric);
      Vec<3> y = Vec<3>::Zero();
      for (size_t c = 0; c < static_cast<size_t>(element.corner_count()); ++c)
        y += shares[c] * cage_.corner(element, static_cast<int>(c));
      data_.entries(panel.element, shares, y, entries);
      for (size_t k = 0; k < 3; ++k) {
        const double weight = rule.weight * panel.area * (2 * rule.barycentric[k] - 1 / 3.0) * unknown_scale(panel);
        for (const BoundaryData::Entry& entry : entries) {
          const DensityColumn at(entry.column, data_);
          densities_[at.group](static_cast<Eigen::Index>(3 * p + k), at.lane) += weight * entry.value;
        }
      }
    }
  }
}

// As many groups as there are threads, some rows of tiles at a time.
void BoundarySolver::solve_groups() {
  if (densities_.front().size() == 0) set_boundary_values();
  const size_t count = std::min(densities_.size() - solved_, parallel_width());
  const size_t first = rows_solved_, end_row = std::min(2 * rows(), first + 1 + kRowProducts / rows());
  parallel_for(count, 1, [&](size_t begin, size_t end) {
    for (size_t g = solved_ + begin; g < solved_ + end; ++g)
      for (size_t row = first; row < end_row; ++row)
        row < rows() ? matrix_.forward(row, densities_[g]) : matrix_.backward(2 * rows() - 1 - row, densities_[g]);
  });
  rows_solved_ = end_row;
  if (end_row < 2 * rows()) return;
  for (size_t g = solved_; g < solved_ + count; ++g)
    for (size_t p = 0; p < panels_.panels.size(); ++p)
      densities_[g].middleRows<3>(static_cast<Eigen::Index>(3 * p)) *= unknown_scale(panels_.panels[p]);
  solved_ += count;
  rows_solved_ = 0;
}

void BoundarySolver::advance() {
  if (assembled_ < tiles()) {
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

std::unique_ptr<const Solution<3>> BoundarySolver::take(const DistanceIndex<3>& distance,
                                                        const WindingNumber<3>& winding) {
  BARYCAST_CHECK_OP(done(), ==, total());
  return std::make_unique<BoundaryField>(cage_, distance, winding, std::move(panels_), data_, std::move(densities_));
}

}  // namespace barycast
