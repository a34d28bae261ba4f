#pragma once

// The border of the ray engines: everything that a line meets of a cage. Engines drop in here; which hits
// there are is decided by `meet` (line_hits.h), whatever the engine proposes. Const after construction
// and safe to call from any number of threads.

#include <memory>
#include <span>

#include "base/result.h"
#include "query/line_hits.h"

namespace barycast {

template <int D>
class LineIndex {
 public:
  virtual ~LineIndex() = default;

  // All hits with t > from of lines through one point in these directions, of unit length. Replaces what `out` held.
  // A line's hits do not depend on the others; some tens together are faster.
  virtual void hits(const Vec<D>& origin, std::span<const Vec<D>> directions, double from, LineHits<D>& out) const = 0;

  virtual size_t bytes() const = 0;
};

// The engine of choice: the sweep for cages in space of this many triangles at most, a quad counting as two; else
// Embree. About as many are as fast either way; from few triangles to 400 the sweep is 1.3 to 1.8 times as fast.
inline constexpr size_t kSweptTrianglesMax = 640;
template <int D>
Result<std::unique_ptr<const LineIndex<D>>> make_line_index(const Cage<D>& cage);

// Embree's traversal over the padded boxes of all elements, in both dimensions. Builds in milliseconds.
// Triangles are user geometry too: Embree's own test works in floats, and of lines aimed at the edges of a
// sphere it lost, in 40 of 100, a triangle that the exact one decides for (a box costs 1.6 times as much).
// Errors: kInternal when Embree fails.
template <int D>
Result<std::unique_ptr<const LineIndex<D>>> make_embree_line_index(const Cage<D>& cage);

// All elements for every line, in vectors (sweep_lanes.h); Embree for lines from far away. Errors: the same.
Result<std::unique_ptr<const LineIndex<3>>> make_line_sweep(const Cage<3>& cage);

}  // namespace barycast
