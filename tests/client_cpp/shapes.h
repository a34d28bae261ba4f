#pragma once

// Small cages and models for the client's tests.

#include <cmath>
#include <vector>

#include "barycast/client/cage.h"

namespace barycast::client::testing {

// The corners of the unit cube, corner i at the bits of i (x lowest).
inline std::vector<double> box_vertices() {
  std::vector<double> vertices;
  for (int i = 0; i < 8; ++i) vertices.insert(vertices.end(), {double(i & 1), double(i >> 1 & 1), double(i >> 2)});
  return vertices;
}

inline CageParts box_parts() {
  return {.control_vertices = box_vertices(),
          .quads = {0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5}};
}

inline Cage box() {
  return std::move(Cage::create(box_parts())).value();
}

// count x 3, inside the box, along a curve.
inline std::vector<double> points_inside(size_t count) {
  std::vector<double> points;
  for (size_t i = 0; i < count; ++i) {
    const double t = static_cast<double>(i);
    points.insert(points.end(),
                  {0.5 + 0.3 * std::sin(t), 0.5 + 0.3 * std::cos(1.7 * t), 0.5 + 0.3 * std::sin(2.3 * t)});
  }
  return points;
}

}  // namespace barycast::client::testing
