#pragma once

// A cover of a cage's interior by balls free of the cage, a function of the cage alone: an octree over its box whose
// leaves are the cells that lie well inside one such ball. A leaf reaches a little beyond its cell, with a weight that
// falls smoothly to zero at the rim of that reach, so that a blend of what leaves say is smooth in the point.
//
// Cells are made where a point first asks, some microseconds each, and stay: a ball's tables hang on its leaf. Safe
// from any number of threads; what is there already cannot change an answer.

#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "base/publish_once.h"
#include "estimate/solid_harmonics.h"
#include "query/distance_index.h"
#include "query/winding.h"

namespace barycast {

// Coefficients of solid harmonics about a ball, columns() of each (estimate/ball_tables.h): steps of a size of the
// harmonic's own, to within some 1e-5 of its largest.
struct BallTable {
  std::array<float, kHarmonics> step{};
  std::vector<int16_t> coefficients;
};

// 0 below 0, 1 above 1, with slopes of 0 there.
inline double smooth_step(double t) {
  return t <= 0 ? 0.0 : t >= 1 ? 1.0 : t * t * (3 - 2 * t);
}

struct BallLeaf {
  uint64_t name = 0;  // of the cell in the octree
  Vec<3> centre = Vec<3>::Zero();
  double radius = 0.0;  // 0: not a leaf
  PublishOnce<BallTable> table;
};

class BallCover {
 public:
  BallCover(const DistanceIndex<3>& distance, const WindingNumber<3>& winding);

  // Every point of the inside at least this far from the cage is in the cells of leaves (in diagonals): six of the
  // default thickness. Nearer, balls would be as many as the points that ask for them.
  static constexpr double kDistanceMin = 6e-3;

  // Calls body(leaf, weight), with a positive weight, for the leaves that reach a point, in a fixed order; their
  // weights do not sum to one.
  template <class Body>
  void for_each(const Vec<3>& x, const Body& body) const {
    visit(root_, x, body);
  }

  // Where the cell that a point is in is a leaf, the point is inside of the cage, and at least this far from it; else
  // 0. Some hundredths of a microsecond.
  double clearance(const Vec<3>& x) const;

  // All leaves, the largest cells first and otherwise in a fixed order, `most` of them at most; fewer when `cancel` was
  // seen set. Makes what is not there, on the threads of the calling arena.
  std::vector<const BallLeaf*> leaves(size_t most, const std::atomic<bool>& cancel) const;

  // Held now, without tables.
  size_t bytes() const { return sizeof(*this) + families_.load(std::memory_order_relaxed) * sizeof(Family); }

 private:
  struct Family;
  struct Cell : BallLeaf {
    Vec<3> middle = Vec<3>::Zero();
    double half = 0.0;  // edge
    bool divided = false;
    PublishOnce<Family> children;
  };
  struct Family {
    std::array<Cell, 8> cells;
  };
  // Of half an edge, by which the reach of a leaf exceeds its cell on every side.
  static constexpr double kOverlap = 0.3;

  // The weight of a cell along one axis: 1 in it, 1/2 at its end, 0 at the end of its reach.
  static double fade(double from_middle, double half) {
    return smooth_step((half * (1 + kOverlap) - std::abs(from_middle)) / (2 * kOverlap * half));
  }

  template <class Body>
  void visit(const Cell& cell, const Vec<3>& x, const Body& body) const {
    const Vec<3> to = x - cell.middle;
    if (cell.radius > 0) {
      const double weight = fade(to[0], cell.half) * fade(to[1], cell.half) * fade(to[2], cell.half);
      if (weight > 0) body(static_cast<const BallLeaf&>(cell), weight);
      return;
    }
    if (!cell.divided) return;
    const Family& family = children(cell);
    const double reach = 0.5 * kOverlap * cell.half, end = cell.half + reach;
    unsigned sides[3];  // that may reach x: 1 below, 2 above
    for (int a = 0; a < 3; ++a)
      sides[a] = (to[a] < reach && to[a] > -end ? 1u : 0u) | (to[a] > -reach && to[a] < end ? 2u : 0u);
    for (unsigned i = 0; i < 8; ++i)
      if ((sides[0] >> (i & 1)) & (sides[1] >> (i >> 1 & 1)) & (sides[2] >> (i >> 2)) & 1)
        visit(family.cells[i], x, body);
  }

  const Family& children(const Cell& cell) const;
  void place_ball(Cell& cell) const;
  const DistanceIndex<3>& distance_;
  const WindingNumber<3>& winding_;
  double half_min_;  // cells are not divided below
  Cell root_;
  mutable std::atomic<size_t> families_ = 0;
};

}  // namespace barycast
