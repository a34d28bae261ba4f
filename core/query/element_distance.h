#pragma once

// Closest points on single elements, in double. The last word on every distance: accelerators only
// propose candidates. Corner shares sum to one and reproduce the point: y = sum share_i corner_i, so
// that moments and basis values come from the same y.

#include <algorithm>
#include <array>
#include <vector>

#include "base/vector.h"
#include "cage/cage.h"

namespace barycast {

template <int D>
struct ElementPoint {
  double distance_squared;
  Vec<D> point;                  // y, on the element
  std::array<double, 4> shares;  // of the corners; unused entries are 0
};

template <int D>
ElementPoint<D> closest_on_segment(const Vec<D>& x, const Vec<D>& a, const Vec<D>& b);

ElementPoint<3> closest_on_triangle(const Vec<3>& x, const Vec<3>& a, const Vec<3>& b, const Vec<3>& c);

// The closest point's shares of the second and the third corner; small enough for registers.
struct TriangleShares {
  double second, third;
  // Of the first corner: 0 on the opposite edge, whatever the others were rounded to.
  double first() const {
    const double rest = 1 - second - third;
    return rest < 4e-16 ? 0.0 : rest;
  }
};
TriangleShares closest_shares(const Vec<3>& x, const Vec<3>& a, const Vec<3>& b, const Vec<3>& c);

// Distance to two triangles at once (a quad cut along a diagonal; or one triangle, twice), for sampling
// decisions alone: floats, one lane per edge.
class TrianglePairDistance {
 public:
  TrianglePairDistance() = default;
  TrianglePairDistance(const std::array<Vec<3>, 3>& first, const std::array<Vec<3>, 3>& second);

  // Never more than the distance to the nearer triangle, and less by 3e-6 of the distance and of the
  // triangles' size at most, but for slivers flatter than that.
  double lower_bound(const Vec<3>& x) const;

 private:
  using Lanes = Eigen::Array<float, 8, 1>;  // 3 edges and one again, of either triangle
  // x -> a . (x - origin) + b, one function per lane.
  struct Linear {
    std::array<Lanes, 3> a;
    Lanes b;
    Lanes operator()(const Eigen::Array3f& x) const { return a[0] * x[0] + (a[1] * x[1] + (a[2] * x[2] + b)); }
  };
  Linear along_;   // the edge, from its first corner
  Linear inward_;  // in the plane, from the edge towards the triangle
  Linear normal_;  // off the plane
  Lanes length_;   // of the edge
  Vec<3> origin_ = Vec<3>::Zero();
  std::array<bool, 2> has_inside_{};
  float size_ = 0.0f;
};

// Parameters of a part of a bilinear patch: [u, u + size] x [v, v + size], powers of two.
struct PatchWindow {
  double u = 0.0, v = 0.0, size = 1.0;
};

// q(u, v) = (1-v) ((1-u) q0 + u q1) + v ((1-u) q3 + u q2), corners in cyclic order [SBC App. B].
struct BilinearPatch {
  std::array<Vec<3>, 4> corner;

  std::array<double, 4> shares(double u, double v) const {
    return {(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v};
  }
  Vec<3> at(double u, double v) const {
    const auto s = shares(u, v);
    return s[0] * corner[0] + s[1] * corner[1] + s[2] * corner[2] + s[3] * corner[3];
  }
  BilinearPatch part(const PatchWindow& window) const;

  // An upper bound on how far any point of the patch lies from its two triangles (0 1 2), (0 2 3), and
  // the other way round.
  double triangle_deviation() const;

  // How often to halve the parameters until the triangles of every part follow the patch within
  // `deviation_max` and within `deviation_of_size` of the part's size; `cuts_max` at most.
  int cuts(double deviation_max, double deviation_of_size, int cuts_max) const;
};

// The patch of a quad.
BilinearPatch patch_of(const Cage<3>& cage, const Element& element);

// Unit normal of an element at the point with these shares: outwards for counter-clockwise elements.
Vec<2> element_normal(const Cage<2>& cage, const Element& element, const std::array<double, 4>& shares);
Vec<3> element_normal(const Cage<3>& cage, const Element& element, const std::array<double, 4>& shares);

// All parts of a patch after `cuts` halvings, row by row.
std::vector<PatchWindow> patch_windows(int cuts);

// Closest point within a window of a patch that is nearly flat there (deviation well below its size, as
// the accelerators cut it): Newton with the parameters clamped, from the closest points on the two
// triangles, from more where corners coincide. Shares are those of the whole patch's corners.
// differs from [SBC App. B]: alternating projections converge linearly on skewed patches; Newton needs
// about three iterations, and falls back to the alternation where a bound is active.
ElementPoint<3> closest_on_patch(const Vec<3>& x, const BilinearPatch& patch, const PatchWindow& window);
// From parameters near the closest point, as one of the two triangles gives them.
ElementPoint<3> closest_on_patch(const Vec<3>& x, const BilinearPatch& patch, const PatchWindow& window, double u,
                                 double v);

}  // namespace barycast
