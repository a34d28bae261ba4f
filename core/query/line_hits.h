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

#include <algorithm>
#include <array>
#include <vector>

#include "base/vector.h"
#include "cage/cage.h"

namespace barycast {

template <int D>
struct LineHit {
  double t;                      // signed distance from the line's origin, along its direction
  uint32_t element;              // of Cage::elements()
  std::array<double, 4> shares;  // of the element's corners; they sum to one
  Vec<D> point;                  // y = sum share_i corner_i
};

// A line through a point, in both directions.
template <int D>
class Line {
 public:
  using Image = Vec<D - 1>;

  // `direction` has unit length.
  Line(const Vec<D>& origin, const Vec<D>& direction);

  const Vec<D>& origin() const { return origin_; }
  const Vec<D>& direction() const { return direction_; }
  // Where a point appears across the line, which itself is at 0; a sheared, not a perpendicular view.
  Image image(const Vec<D>& point) const;

 private:
  Vec<D> origin_, direction_;
  std::array<int, 3> axis_{};  // D = 3: the last is the largest of the direction
  std::array<double, 2> shear_{};
};

// Writes the hits of an element into `hits` and returns their number: 0 or 1, for a patch up to 2.
template <int D>
int meet(const Line<D>& line, const Cage<D>& cage, uint32_t element, std::array<LineHit<D>, 2>& hits);

// Appends the hits of an element with t > from.
template <int D>
void append_hits(const Line<D>& line, const Cage<D>& cage, uint32_t element, double from,
                 std::vector<LineHit<D>>& hits) {
  std::array<LineHit<D>, 2> found;
  const int count = meet(line, cage, element, found);
  for (int i = 0; i < count; ++i)
    if (const LineHit<D>& hit = found[static_cast<size_t>(i)]; hit.t > from) hits.push_back(hit);
}

// Ascending in t, at equal t by element; the two hits of one patch that are equal in both stay in the order of its
// roots. A line has few.
template <int D>
void sort_hits(std::vector<LineHit<D>>& hits) {
  const auto before = [](const LineHit<D>& a, const LineHit<D>& b) {
    return a.t < b.t || (a.t == b.t && a.element < b.element);
  };
  if (hits.size() > 16) return std::stable_sort(hits.begin(), hits.end(), before);
  for (auto next = hits.begin(); next != hits.end(); ++next)
    std::rotate(std::upper_bound(hits.begin(), next, *next, before), next, next + 1);
}

extern template class Line<2>;
extern template class Line<3>;

}  // namespace barycast
