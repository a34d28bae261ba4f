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

// A triangle in its own plane's frame, for the distance alone: a third of the time of the closest point.
// Within rounding of closest_on_triangle; degenerate triangles act as their longest edge.
class TriangleDistance {
 public:
  TriangleDistance() = default;
  TriangleDistance(const Vec<3>& a, const Vec<3>& b, const Vec<3>& c);

  double squared(const Vec<3>& x) const {
    const Vec<3> local = axes_ * x + offset_;
    const double px = local[0], py = local[1];
    const double from_b = px - length_;
    // Distance to an edge given by its unit direction and length, in the plane.
    const auto edge = [](double dx, double dy, double ux, double uy, double length) {
      const double t = std::min(std::max(dx * ux + dy * uy, 0.0), length);
      const double ex = dx - t * ux, ey = dy - t * uy;
      return ex * ex + ey * ey;
    };
    const double along = px - std::min(std::max(px, 0.0), length_);
    const double outside = std::min({along * along + py * py, edge(px, py, ac_[0], ac_[1], ac_length_),
                                     edge(from_b, py, bc_[0], bc_[1], bc_length_)});
    const bool inside = py >= 0.0 && px * ac_[1] - py * ac_[0] >= 0.0 && from_b * bc_[1] - py * bc_[0] <= 0.0;
    return (inside ? 0.0 : outside) + local[2] * local[2];
  }

 private:
  Mat<3> axes_ = Mat<3>::Identity();  // rows: along ab, across towards c, normal
  Vec<3> offset_ = Vec<3>::Zero();
  double length_ = 0.0, ac_length_ = 0.0, bc_length_ = 0.0;
  Vec<2> ac_ = Vec<2>::UnitX(), bc_ = Vec<2>::UnitX();  // unit directions in the plane
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
// the accelerators cut it): Newton with the parameters clamped, from the closest point on the two
// triangles. Shares are those of the whole patch's corners.
// differs from [SBC App. B]: alternating projections converge linearly on skewed patches; Newton needs
// about three iterations, and falls back to the alternation where a bound is active.
ElementPoint<3> closest_on_patch(const Vec<3>& x, const BilinearPatch& patch, const PatchWindow& window);

}  // namespace barycast
