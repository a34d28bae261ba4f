#pragma once

// The cage cut into flat triangles, the panels of the boundary elements: small where densities are steep. Quads
// are cut on their bilinear patch, never along a diagonal: flat halves would bias coordinates by 0.01.

#include <array>
#include <cstdint>
#include <vector>

#include "base/result.h"
#include "cage/cage.h"

namespace barycast {

// Densities are linear on a panel and may jump between panels. They are given by their values at the three points
// where the barycentric coordinates are 2/3, 1/6, 1/6: the rule of degree two there makes their functions
// orthogonal, and turns a panel that is far away into three points.
struct Panel {
  std::array<Vec<3>, 3> corner;
  std::array<Vec<3>, 3> point;  // of the density's values
  std::array<Vec<3>, 3>
      gradient;  // of the function that is 1 at one point and 0 at the others; at the centre it is 1/3
  Vec<3> normal, centre;
  double area, radius;  // the farthest corner from the centre
  uint32_t element;
  std::array<Vec<2>, 3> parameter;  // of the corners: u, v of a quad; shares of the second and third corner
};

struct Panels {
  std::vector<Panel> panels;      // those of an element are consecutive
  std::vector<double> node_size;  // typical side of the panels about a node of the cage, in diagonals

  // As many as `count` allows, of about equal size but graded towards the edges of the elements. Errors:
  // kInvalidArgument (the cage has so many elements that they need more).
  static Result<Panels> cut(const Cage<3>& cage, uint32_t count);
  // Whether `cut` would succeed. Errors: the same.
  static Status check(const Cage<3>& cage, uint32_t count);
};

// Shares of an element's corners at a point of one of its panels, by the barycentric coordinates in the panel.
std::array<double, 4> element_shares(ElementKind kind, const Panel& panel, const std::array<double, 3>& barycentric);

// The point of an element with these shares of its corners.
Vec<3> point_at(const Cage<3>& cage, const Element& element, const std::array<double, 4>& shares);

// Seven points of a triangle, exact to degree five [Radon 1948]; weights sum to one.
struct TrianglePoint {
  std::array<double, 3> barycentric;
  double weight;
};
extern const std::array<TrianglePoint, 7> kTriangleRule;

}  // namespace barycast
