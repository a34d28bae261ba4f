#pragma once

// The border of the ray engines: everything that a line meets of a cage. Engines drop in here; which hits
// there are is decided by `meet` (line_hits.h), whatever the engine proposes. Const after construction
// and safe to call from any number of threads.

#include <memory>
#include <vector>

#include "query/line_hits.h"

namespace barycast {

template <int D>
class LineIndex {
 public:
  virtual ~LineIndex() = default;

  // All hits with t > from, ascending in t, at equal t by element. Replaces what `out` held.
  virtual void hits(const Line<D>& line, double from, std::vector<LineHit<D>>& out) const = 0;

  virtual size_t bytes() const = 0;
};

// Embree's traversal over the padded boxes of all elements, in both dimensions. Builds in milliseconds.
// Triangles are user geometry too: Embree's own test works in floats, and of lines aimed at the edges of a
// sphere it lost, in 40 of 100, a triangle that the exact one decides for (a box costs 1.6 times as much).
// Errors: kInternal when Embree fails.
template <int D>
Result<std::unique_ptr<const LineIndex<D>>> make_embree_line_index(const Cage<D>& cage);

}  // namespace barycast
