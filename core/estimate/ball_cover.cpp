#include "estimate/ball_cover.h"

#include "base/parallel.h"

namespace barycast {
namespace {

// The reach of a leaf lies within this part of its ball's radius: there the three lowest degrees are nearly all that a
// harmonic function has.
constexpr double kInsideBall = 0.8;
// How often a ball that does not hold its cell is moved away from the cage, and how far, in half edges. Beside a flat
// piece of the cage two moves make cells of twice the size leaves.
constexpr int kMoves = 3;
constexpr double kMove = 0.7;
// Nothing to be gained by moving where the cell reaches further than this out of the ball.
constexpr double kHopeless = 2.2;
// Cells that one task divides, eight distances each.
constexpr size_t kCellsPerTask = 32;
// For rounding; walks round down again.
constexpr double kFree = 1 - 1e-6;

}  // namespace

// A cell of half edge h about a point at distance d becomes a leaf at the latest when its own ball holds it,
// sqrt(3) (1 + overlap) h <= inside (d - sqrt(3) h).
BallCover::BallCover(const DistanceIndex<3>& distance, const WindingNumber<3>& winding)
    : distance_(distance),
      winding_(winding),
      half_min_(kFree * kInsideBall * kDistanceMin / (std::sqrt(3.0) * (1 + kOverlap + kInsideBall))) {
  // The cage lies within half a diagonal of the origin; the smallest cells are as large as may be.
  for (root_.half = half_min_; root_.half < 0.5;) root_.half *= 2;
  root_.name = 1;
  place_ball(root_);
}

// Makes a cell a leaf, or one to be divided, or neither: where it is outside, or too near to the cage.
void BallCover::place_ball(Cell& cell) const {
  Vec<3> at = cell.middle;
  bool one_side = false;
  for (int move = 0; move <= kMoves; ++move) {
    const CagePoint<3> closest = distance_.closest(at);
    const double reach = ((at - cell.middle).cwiseAbs().array() + cell.half * (1 + kOverlap)).matrix().norm();
    const double radius = kFree * closest.distance;
    if (move == 0) {
      if (closest.distance + reach < kDistanceMin) return;
      // A ball free of the cage that holds the cell, here or later, is on the cell's side.
      one_side = std::sqrt(3.0) * cell.half < radius;
      if (one_side && !winding_.inside(at)) return;
    }
    if (reach <= kInsideBall * radius) {
      if (!one_side && !winding_.inside(at)) return;
      cell.centre = at;
      cell.radius = radius;
      return;
    }
    if (closest.distance <= 0 || reach > kHopeless * radius) break;
    at += kMove * cell.half / closest.distance * (at - closest.point);
  }
  cell.divided = cell.half > 1.5 * half_min_;
}

const BallCover::Family& BallCover::children(const Cell& cell) const {
  if (const Family* const there = cell.children.get(); there != nullptr) return *there;
  auto family = std::make_unique<Family>();
  for (unsigned i = 0; i < 8; ++i) {
    Cell& child = family->cells[i];
    child.half = 0.5 * cell.half;
    child.name = 8 * cell.name + i;
    for (unsigned a = 0; a < 3; ++a) child.middle[a] = cell.middle[a] + ((i >> a & 1) != 0 ? child.half : -child.half);
    place_ball(child);
  }
  std::unique_ptr<const Family> made = std::move(family);
  if (cell.children.publish(made)) families_.fetch_add(1, std::memory_order_relaxed);
  return *cell.children.get();
}

double BallCover::clearance(const Vec<3>& x) const {
  if (x.cwiseAbs().maxCoeff() > root_.half) return 0.0;
  const Cell* cell = &root_;
  while (cell->divided) {
    size_t i = 0;
    for (int a = 0; a < 3; ++a) i |= size_t{x[a] > cell->middle[a]} << a;
    cell = &children(*cell).cells[i];
  }
  return cell->radius > 0 ? cell->radius - (x - cell->centre).norm() : 0.0;
}

std::vector<const BallLeaf*> BallCover::leaves(size_t most, const std::atomic<bool>& cancel) const {
  std::vector<const BallLeaf*> leaves;
  std::vector<const Cell*> level = {&root_}, next;
  for (; !level.empty(); level.swap(next)) {
    next.clear();
    std::atomic<bool> complete = true;
    parallel_build(level.size(), kCellsPerTask, [&](size_t begin, size_t end) {
      for (size_t i = begin; i < end && complete; ++i) {
        if (cancel.load(std::memory_order_relaxed)) complete = false;
        if (level[i]->divided) children(*level[i]);
      }
    });
    if (!complete) break;
    for (const Cell* cell : level) {
      if (leaves.size() == most) return leaves;
      if (cell->radius > 0) leaves.push_back(cell);
      if (!cell->divided) continue;
      for (const Cell& child : children(*cell).cells)
        if (child.radius > 0 || child.divided) next.push_back(&child);
    }
  }
  return leaves;
}

}  // namespace barycast
