#pragma once

// The elements of a cage cut into small flat triangles that remember where on their element they lie, and the closest
// point of such a triangle. A patch cut k x k is off by at most a quarter of its twist over k^2.

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "cage/cage.h"
#include "solve/panels.h"

namespace barycast::testing {

struct Facet {
  uint32_t element;
  std::array<Vec<3>, 3> corner;
  std::array<Eigen::Vector2d, 3> place;  // of each corner, in the parameters of its element
};

// Corner shares at the parameters (s, t) of an element.
inline std::array<double, 4> shares_at(const Element& element, const Eigen::Vector2d& place) {
  const double s = place[0], t = place[1];
  if (element.kind == ElementKind::kTriangle) return {1 - s - t, s, t, 0};
  return {(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t};
}

// Facets with edges of about `size` (those across a triangle or a quad: half as much again).
inline std::vector<Facet> facets_of(const Cage<3>& cage, double size) {
  std::vector<Facet> facets;
  for (uint32_t e = 0; e < cage.elements().size(); ++e) {
    const Element& element = cage.elements()[e];
    double longest = 0.0;
    for (int i = 0; i < element.corner_count(); ++i)
      longest =
          std::max(longest, (cage.corner(element, (i + 1) % element.corner_count()) - cage.corner(element, i)).norm());
    const int cuts = std::max(1, static_cast<int>(std::ceil(longest / size)));
    const auto add = [&](const std::array<Eigen::Vector2d, 3>& lattice) {
      Facet facet{.element = e, .corner = {}, .place = {}};
      for (size_t i = 0; i < 3; ++i) {
        facet.place[i] = lattice[i] / cuts;
        facet.corner[i] = point_at(cage, element, shares_at(element, facet.place[i]));
      }
      facets.push_back(facet);
    };
    const bool quad = element.kind == ElementKind::kQuad;
    for (int i = 0; i < cuts; ++i)
      for (int j = 0; j < cuts; ++j) {
        if (quad || i + j < cuts) add({Eigen::Vector2d(i, j), Eigen::Vector2d(i + 1, j), Eigen::Vector2d(i, j + 1)});
        if (quad || i + j + 1 < cuts)
          add({Eigen::Vector2d(i + 1, j), Eigen::Vector2d(i + 1, j + 1), Eigen::Vector2d(i, j + 1)});
      }
  }
  return facets;
}

// Shares of the corners at the point of a triangle that is closest to x: the foot of the perpendicular, or else the
// nearest of the closest points of its edges.
inline Vec<3> closest_shares(const std::array<Vec<3>, 3>& corner, const Vec<3>& x) {
  const Vec<3> normal = (corner[1] - corner[0]).cross(corner[2] - corner[0]);
  Vec<3> shares;
  for (size_t i = 0; i < 3; ++i) {
    const Vec<3>& a = corner[(i + 1) % 3];
    const Vec<3>& b = corner[(i + 2) % 3];
    shares[static_cast<int>(i)] = (b - a).cross(x - a).dot(normal) / normal.squaredNorm();
  }
  if (shares.minCoeff() >= 0) return shares;  // false where there is no area
  double nearest = -1.0;
  for (size_t i = 0; i < 3; ++i) {
    const size_t j = (i + 1) % 3;
    const Vec<3> edge = corner[j] - corner[i];
    const double along =
        edge.squaredNorm() > 0 ? std::clamp((x - corner[i]).dot(edge) / edge.squaredNorm(), 0.0, 1.0) : 0;
    const double distance = (corner[i] + along * edge - x).squaredNorm();
    if (nearest >= 0 && distance >= nearest) continue;
    nearest = distance;
    shares.setZero();
    shares[static_cast<int>(i)] = 1 - along;
    shares[static_cast<int>(j)] = along;
  }
  return shares;
}

// Whether a triangle and a cube with the given centre and half edge touch: no axis separates them.
inline bool touches_cube(const std::array<Vec<3>, 3>& corner, const Vec<3>& centre, double half) {
  const std::array<Vec<3>, 3> edge = {corner[1] - corner[0], corner[2] - corner[1], corner[0] - corner[2]};
  const auto separates = [&](const Vec<3>& axis) {
    const double a = axis.dot(corner[0] - centre), b = axis.dot(corner[1] - centre), c = axis.dot(corner[2] - centre);
    const double reach = half * axis.cwiseAbs().sum() * (1 + 1e-12);
    return std::min({a, b, c}) > reach || std::max({a, b, c}) < -reach;
  };
  if (separates(edge[0].cross(edge[1]))) return false;
  for (int k = 0; k < 3; ++k) {
    const Vec<3> unit = Vec<3>::Unit(k);
    if (separates(unit)) return false;
    for (const Vec<3>& along : edge)
      if (separates(unit.cross(along))) return false;
  }
  return true;
}

}  // namespace barycast::testing
