#pragma once

// Harmonic coordinates by boundary elements [Sauter and Schwab 2011, ch. 3].
//
// Outside and for open cages, an indirect single layer: the harmonic function with values f on the cage is the
// potential of a density on it, the same on both sides, which vanishes far away: the hitting measure of a walk that may
// escape. Projected moments then make the coordinates.
//
// Inside closed cages the coordinates are the functions with values phi_v themselves, by Green's representation
// u = S[t] - D[phi_v]: the single layer has to add only what the dipoles of phi_v lack. Its density is that of the
// inside alone, smooth at edges that bulge outwards, where the indirect one is infinite. Cages that cut themselves,
// or hold parts of themselves, have no such inside: there the indirect layer serves too.
//
// Densities are piecewise linear on graded panels and fulfil the boundary values in the mean over every panel's
// functions (Galerkin); the matrix is the same for all, symmetric and positive definite for every cage. Near the cage
// the potential's own error on it, which is known, is taken off, fading over a part of a panel: values approach the
// basis. The correction follows the one closest point: where that changes values have steps, of some ten-thousandths
// inside and thousandths outside next to edges, and gradients leave out how its reach varies. Between a twisted patch
// and its panels inside is continued from the one panel below the point: beside a panel's edges there, steps of up to
// 0.02 were seen (a sphere of quads twisted by 5 percent; in 95 of 100 places none).
//
// In-plane gradients are infinite on the edges of panels, and steep outside and at inward edges of the cage, where
// densities jump: within a tenth of a panel of one they are off by their own size and more.
//
// Deterministic. Cost: 3 unknowns a panel; n^3 / 3 once (0.5 s for 1,000 panels on two cores), then 0.1 to 0.3 ms a
// point.

#include <memory>

#include "base/result.h"
#include "base/warning.h"
#include "query/distance_index.h"
#include "query/winding.h"
#include "solve/boundary_data.h"
#include "solve/boundary_field.h"
#include "solve/double_layer.h"
#include "solve/panel_kernels.h"
#include "solve/panels.h"
#include "solve/solution.h"
#include "solve/tiled_cholesky.h"

namespace barycast {

// Where the solution is asked for: inside a closed cage, where values will do, or elsewhere, where moments are needed.
// Cages that have no inside get a layer for both sides.
enum class BoundarySides { kInside, kElsewhere, kBoth };

struct BoundarySettings {
  uint32_t panels = 1000;  // at most
  BoundarySides sides = BoundarySides::kBoth;
};

// Solves in pieces of about ten milliseconds, each on all threads of the calling arena.
class BoundarySolver {
 public:
  // The cage must outlive what comes of it. Errors: kInvalidArgument ("panels": the cage needs more).
  static Result<std::unique_ptr<BoundarySolver>> create(const Cage<3>& cage, const BoundarySettings& settings);

  // In no unit in particular. A cage found to have no inside, see above, changes the total.
  size_t done() const { return dipoles_done_ + assembled_ + matrix_.columns_done() + solved_ + rows_solved_; }
  size_t total() const;

  // The next piece.
  void advance();
  // What was met on the way: elements too close together.
  std::vector<Warning> warnings() const;

  // Once done() == total(); the solver is spent.
  std::unique_ptr<const Solution<3>> take(const DistanceIndex<3>& distance, const WindingNumber<3>& winding);
  BoundaryParts take_parts();

  // Peak of memory while solving, and what the solution keeps, if all panels are used.
  static size_t bytes(const BoundarySettings& settings, size_t control_vertices);
  static size_t solved_bytes(const BoundarySettings& settings, size_t control_vertices);

 private:
  BoundarySolver(const Cage<3>& cage, Panels panels, BoundarySides sides);
  const std::vector<Panel>& panels() const { return kernels_.panels().panels; }
  size_t rows() const { return matrix_.tile_count(); }
  size_t tiles() const { return rows() * (rows() + 1) / 2; }
  size_t groups() const { return densities_.inside.size() + densities_.indirect.size(); }
  TiledCholesky::Columns& group(size_t g);
  void subtract_dipoles();
  bool subtract_dipoles(size_t panel, PanelKernels::Tables& kernels);
  void add_boundary_values(DensityGroups& groups);
  void assemble();
  void assemble_tile(size_t row, size_t column);
  void solve_groups();

  const Cage<3>& cage_;
  PanelKernels kernels_;
  BoundaryData data_;
  DoubleLayer dipoles_;
  TiledCholesky matrix_;
  BoundaryDensities densities_;
  size_t dipoles_done_ = 0;  // panels
  size_t assembled_ = 0;     // tiles
  size_t solved_ = 0;        // rows of tiles of all groups, there and back
  size_t rows_solved_ = 0;   // of those of them that are under way
};

}  // namespace barycast
