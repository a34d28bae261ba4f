#pragma once

// Harmonic coordinates by boundary elements: an indirect single layer [Sauter and Schwab 2011, ch. 3]. The harmonic
// function with values f on the cage is the potential of a density on it; the density is piecewise linear on graded
// panels and fulfils the boundary values in the mean over every panel's functions (Galerkin), so that the system is
// symmetric and positive definite for every cage, closed or open. The same density serves inside and outside,
// where the potential vanishes far away: the hitting measure of a walk that may escape.
//
// Inside closed cages the coordinates are the potentials of the phi_v; elsewhere, projected moments. Near the cage
// the potential's own error on it, which is known, is taken off, fading over a part of a panel: values approach the
// basis. The correction follows the one closest point: values have steps of some thousandths across the bisector of two
// faces next to their edge, and gradients leave out how its reach varies. In-plane gradients are infinite at edges,
// where densities jump: within a tenth of a panel of one they are off by their own size and more.
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
#include "solve/panels.h"
#include "solve/solution.h"
#include "solve/tiled_cholesky.h"

namespace barycast {

struct BoundarySettings {
  uint32_t panels = 1000;  // at most
  bool moments = true;     // false: points inside a closed cage only
};

// Solves in pieces of about ten milliseconds, each on all threads of the calling arena.
class BoundarySolver {
 public:
  // The cage must outlive what comes of it. Errors: kInvalidArgument ("panels": the cage needs more).
  static Result<std::unique_ptr<BoundarySolver>> create(const Cage<3>& cage, const BoundarySettings& settings);

  // In no unit in particular.
  size_t done() const { return assembled_ + matrix_.columns_done() + 2 * rows() * solved_ + rows_solved_; }
  size_t total() const { return tiles() + rows() + 2 * rows() * densities_.size(); }

  // The next piece.
  void advance();
  // What was met on the way: elements too close together.
  std::vector<Warning> warnings() const;

  // Once done() == total(); the solver is spent.
  std::unique_ptr<const Solution<3>> take(const DistanceIndex<3>& distance, const WindingNumber<3>& winding);

  // Peak of memory while solving, and what the solution keeps, if all panels are used.
  static size_t bytes(const BoundarySettings& settings, size_t control_vertices);
  static size_t solved_bytes(const BoundarySettings& settings, size_t control_vertices);

 private:
  BoundarySolver(const Cage<3>& cage, Panels panels, bool moments);
  size_t rows() const { return matrix_.tile_count(); }
  size_t tiles() const { return rows() * (rows() + 1) / 2; }
  void assemble();
  void assemble_tile(size_t row, size_t column);
  void set_boundary_values();
  void solve_groups();

  const Cage<3>& cage_;
  Panels panels_;
  BoundaryData data_;
  TiledCholesky matrix_;
  std::vector<TiledCholesky::Columns> densities_;  // a group of columns each
  size_t assembled_ = 0;                           // rows of tiles
  size_t solved_ = 0, rows_solved_ = 0;            // groups, and rows of tiles of those under way, there and back
};

}  // namespace barycast
