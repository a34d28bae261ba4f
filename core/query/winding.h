#pragma once

// Generalized winding number of a cage [Jacobson et al. 2013], through a tree of dipoles for far
// clusters [Barill et al. 2018]: which points are inside, for any cage, closed or not. 1 inside a closed
// cage with outward normals, 0 outside; fractions near open boundaries. Exact for near elements, within
// about 0.01 for far ones. Microseconds per query; const and thread-safe.

#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "cage/cage.h"

namespace barycast {

template <int D>
class WindingNumber {
 public:
  explicit WindingNumber(const Cage<D>& cage);

  double operator()(const Vec<D>& x) const { return facets_.empty() ? 0.0 : evaluate(0, x); }

  // Whether the magnitude is one half or more; elements may face either way.
  bool inside(const Vec<D>& x) const { return std::abs((*this)(x)) >= 0.5; }

  size_t bytes() const { return sizeof(*this) + facets_.capacity() * sizeof(Facet) + nodes_.capacity() * sizeof(Node); }

 private:
  using Facet = std::array<Vec<D>, D>;  // a segment or a triangle
  struct Node {
    Vec<D> centre = Vec<D>::Zero();  // mean of the facets, weighted by area
    Vec<D> dipole = Vec<D>::Zero();  // sum of normal times area
    double radius = 0.0;             // covers the facets, about the centre
    uint32_t begin = 0, end = 0;     // facets
    uint32_t left = 0, right = 0;    // children; 0: a leaf
  };

  uint32_t build(uint32_t begin, uint32_t end);
  double evaluate(uint32_t node, const Vec<D>& x) const;

  std::vector<Facet> facets_;
  std::vector<Node> nodes_;
};

// Which points are inside, for points that come one after the other, each with a radius about it that is free of the
// cage. Of a closed cage the number is the same all over such a ball, so that the next point in it needs no evaluation:
// the answers are those of `inside`, for balls kept off the facets that stand for patches.
template <int D>
class InsideTest {
 public:
  // closed: the elements bound a volume; false: every point is evaluated.
  InsideTest(const WindingNumber<D>& winding, bool closed) : winding_(winding), closed_(closed) {}

  bool operator()(const Vec<D>& x, double free_radius) {
    if (!closed_) return winding_.inside(x);
    if (!((x - centre_).norm() < radius_)) inside_ = winding_.inside(x);
    centre_ = x;
    radius_ = free_radius - kFacetDeviation;
    return inside_;
  }

 private:
  static constexpr double kFacetDeviation = 5e-3;  // and more: of facets from patches
  const WindingNumber<D>& winding_;
  bool closed_;
  Vec<D> centre_ = Vec<D>::Zero();
  double radius_ = 0.0;
  bool inside_ = false;
};

extern template class WindingNumber<2>;
extern template class WindingNumber<3>;

}  // namespace barycast
