#pragma once

// Sums over panels (solve/panel_sums.h) at a cost that hardly grows with their number: cells of a grid over the cage
// hold what all panels far from them add up to, as a local expansion in solid harmonics [Greengard, Rokhlin 1987]. A
// point sums the panels near its cell one by one, and the expansion.
//
// There are two grids, of edges of an eighth and a sixteenth of the diagonal. An expansion is a fit at points all over
// the sphere about its cell, of the panels that are far from the cell; from a fine cell only those that are near its
// coarse one, and that one's expansion. As many coarse cells are divided as fit into the memory, those with the most
// near panels first.
//
// Off the sums by some 2e-5 of a row, 3e-4 at worst, and gradients by 2e-4 of their RMS, for cages of character models;
// by up to 7e-4 for slivers. As much values jump where one cell ends and the next begins. Outside of the box that holds
// the panels they are the sums.
//
// Cost, on a core with AVX-512, points of a mesh in lists of 256, 48 columns, 296 panels: .9 us a point (the
// sums: 2.4), with gradients 2.2 us (7.3); 152 columns, 599 panels: 2.6 (7.7) and 8.2 (27.5). To make a cell takes some
// tens of microseconds, 64 sums of its panels: points that have it to themselves take longer than by sums.
//
// Cells are made where points first ask for them, and depend on the panels alone: what is there already changes no bit.
// A point's row is a function of that point. Safe from any number of threads.

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
  // Of all columns of `sums`, whose panels these are; both must outlive the expansions.
  LocalExpansions(const PanelSums& sums, const Panels& panels, size_t bytes_max = kBytesMax);
  ~LocalExpansions();

  static constexpr size_t kBytesMax = size_t{24} << 20;

  // Whether expansions of these sums are as good as is said above. The walls of thin cages carry large charges that
  // nearly cancel each other: floats lose digits of the sums there, and expansions would lose more.
  static bool hold(const PanelSums& sums, const Panels& panels);

  // As PanelSums::evaluate, of all columns. False: `cancel` was seen set.
  bool evaluate(std::span<const Vec<3>> points, bool gradients, const std::atomic<bool>& cancel,
                PanelSums::Rows& out) const;

  // Held now.
  size_t bytes() const { return bytes_.load(std::memory_order_relaxed); }
  // The same when so many points have asked, as an estimate: of points of a surface, or the most.
  static size_t expected_bytes(size_t points, size_t columns);
  static size_t most_bytes(size_t points, size_t columns);

 private:
  struct Cell;
  struct CoarseCell;
  enum class Use : uint8_t { kNone, kWhole, kDivided };  // of a coarse cell
  static constexpr uint32_t kCoarse = 8;                 // cells along an edge of the box, fine ones are twice as many
  static constexpr uint32_t kChildren = 8, kWhole = kChildren;
  static constexpr uint32_t kOutside = kCoarse * kCoarse * kCoarse * (kChildren + 1);

  void choose_uses(size_t bytes_max);
  // Of the cell that is for a point: its coarse one's number, times kChildren + 1, and its child's, or kWhole.
  uint32_t name_of(const Vec<3>& x) const;
  const Cell& cell(uint32_t name) const;
  const CoarseCell& coarse_cell(uint32_t number) const;
  void expand(std::span<const uint32_t> candidates, const SumExpansion* others, Cell& cell) const;
  template <class T>
  const T& keep(std::unique_ptr<const T> made, const PublishOnce<T>& place) const;

  const PanelSums& sums_;
  const Panels& panels_;
  std::vector<Use> uses_;
  std::vector<PublishOnce<CoarseCell>> coarse_;
  mutable std::atomic<size_t> bytes_ = 0;
};

}  // namespace barycast
