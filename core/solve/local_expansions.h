#pragma once

// Sums over panels (solve/panel_sums.h) at a cost that hardly grows with their number: cells of a grid over the cage
// hold what all panels far from them add up to, as a local expansion in solid harmonics [Greengard, Rokhlin 1987]. A
// point sums the panels near its cell one by one, and the expansion.
//
// There are two grids, of edges of an eighth and a sixteenth of the diagonal. An expansion is a fit at points all over
// the sphere about its cell, of the panels that are far from the cell; from a fine cell only those that are near its
// coarse one, and that one's expansion.
//
// Off the sums by some 2e-5 of a row, 2e-4 at worst, and gradients by 2e-4 of their RMS, for cages of character models;
// as much where one cell ends and the next begins. Outside of the box that holds the cage they are the sums.
//
// Cost, on a core with AVX-512, points of a mesh in lists of 256, 48 columns, 296 panels: .9 us a point (the
// sums: 2.4), with gradients 2.2 us (7.3); 152 columns, 599 panels: 2.6 (7.7) and 8.2 (27.5). To make a cell takes some
// tens of microseconds.
//
// Panels with large charges, as the walls of thin cages have, which nearly cancel each other, are summed one by one
// from further away. Where charges are so large that floats lose the sums, expansions would lose more: see hold().
//
// Cells are made where points first ask for them, and depend on the panels alone: what is there already, and whether
// one could be kept, changes no bit. A point's row is a function of that point. Safe from any number of threads.

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "base/publish_once.h"
#include "solve/panel_sums.h"

namespace barycast {

class LocalExpansions {
 public:
  // Of all columns of `sums`, whose panels these are; both must outlive the expansions. Cells beyond `bytes_max` are
  // made and dropped, as often as points ask for them.
  LocalExpansions(const PanelSums& sums, const Panels& panels, size_t bytes_max = kBytesMax);
  ~LocalExpansions();

  // Whether expansions of these sums are as good as is said above.
  static bool hold(const PanelSums& sums);

  // All cells of a surface and 250 control vertices, or of a cube and 90.
  static constexpr size_t kBytesMax = size_t{24} << 20;

  // As PanelSums::evaluate, of all columns.
  void evaluate(std::span<const Vec<3>> points, bool gradients, PanelSums::Rows& out) const;

  // Held now.
  size_t bytes() const { return bytes_.load(std::memory_order_relaxed); }
  // The same when so many points have asked, as an estimate: of points of a surface, or the most.
  static size_t expected_bytes(size_t points, size_t columns);
  static size_t most_bytes(size_t points, size_t columns);

 private:
  struct Cell;
  struct CoarseCell;
  static constexpr uint32_t kCoarse = 8, kFine = 2 * kCoarse;  // cells along an edge of the box
  // Of a fine cell, as kFine digits; kFine^3 outside of the box.
  static uint32_t name_of(const Vec<3>& x);

  // A cell is kept where it belongs or, if that cannot be, left in the other argument.
  const Cell& fine_cell(uint32_t name, std::unique_ptr<const Cell>& dropped) const;
  const CoarseCell& coarse_cell(const std::array<uint32_t, 3>& at, std::unique_ptr<const CoarseCell>& dropped) const;
  void expand(std::span<const uint32_t> candidates, const SumExpansion* others, Cell& cell) const;
  template <class T>
  const T& keep(std::unique_ptr<const T> made, const PublishOnce<T>& place, std::unique_ptr<const T>& dropped) const;

  const PanelSums& sums_;
  const Panels& panels_;
  std::vector<double> far_;  // of a panel: how far from a cell, in distances of the cell's corners
  size_t bytes_max_;
  std::vector<PublishOnce<CoarseCell>> coarse_;
  mutable std::atomic<size_t> bytes_ = 0;
};

}  // namespace barycast
