#pragma once

// Where a line meets single elements, in double: the last word on every hit. Accelerators only propose
// candidates.
//
// Seen along the line, every node of the cage has one image, and whether an element lies across the line
// is decided by exact signs of its edges' images, as if the line were moved by an infinitesimal amount
// where it passes an edge or a vertex [Edelsbrunner and Muecke 1990]. Elements that share an edge share
// its sign, so a line through an edge or a vertex meets a closed cage an even number of times: no hit is
// doubled or lost. A bilinear patch is met once, or as often as its boundary winds around the line, modulo
// two; where, is the quadratic of Reshetov [2019] in the images.

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/vector.h"
#include "cage/cage.h"

namespace barycast {

template <int D>
struct LineHit {
  double t;                      // signed distance from the line's origin, along its direction
  uint32_t element;              // of Cage::elements()
  uint32_t line;                 // of those that were asked for together
  std::array<double, 4> shares;  // of the element's corners; they sum to one
  Vec<D> point;                  // y = sum share_i corner_i
};

// A line, and an element that it may meet.
struct LineCandidate {
  uint32_t line, element;
};

// What some lines through one point meet. Of one thread; keeps its memory.
template <int D>
struct LineHits {
  std::vector<LineHit<D>> hits;  // in no particular order
  std::vector<uint32_t> order;   // of hits: by line, ascending in t, at equal t by element; two hits of one patch that
                                 // are equal in both stay in the order of its roots
  std::vector<uint32_t> end;     // of every line, in `order`

  std::span<const uint32_t> of_line(size_t line) const {
    const size_t begin = line == 0 ? 0 : end[line - 1];
    return std::span(order).subspan(begin, end[line] - begin);
  }

  // Memory of engines: triangles, or all elements, and quads.
  std::array<std::vector<LineCandidate>, 2> candidates;
};

// Of a line with a direction of unit length. Writes the hits of an element into `hits` and returns their number: 0 or
// 1, for a patch up to 2. Many at a time are faster: meet_lanes.h.
template <int D>
int meet(const Vec<D>& origin, const Vec<D>& direction, const Cage<D>& cage, uint32_t element,
         std::array<LineHit<D>, 2>& hits);
template <>
int meet(const Vec<2>& origin, const Vec<2>& direction, const Cage<2>& cage, uint32_t element,
         std::array<LineHit<2>, 2>& hits);
template <>
int meet(const Vec<3>& origin, const Vec<3>& direction, const Cage<3>& cage, uint32_t element,
         std::array<LineHit<3>, 2>& hits);

// Fills `order` and `end` from the hits of so many lines.
template <int D>
void order_hits(size_t lines, LineHits<D>& hits);

}  // namespace barycast
