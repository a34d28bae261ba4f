#pragma once

// Mean value coordinates in closed form, for points off the cage: of polygons [Hormann and Floater 2006] and
// of closed triangle meshes [Ju et al. 2005]. Plain double code, good to about 1e-9 for points that are not
// close to the plane of a triangle.

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/vector.h"
#include "support/shapes.h"

namespace barycast::testing {

template <int D>
Vec<D> vertex_of(const Shape& shape, uint32_t v) {
  return Eigen::Map<const Vec<D>>(shape.vertices.data() + D * v);
}

inline std::vector<double> normalized(std::vector<double> weights) {
  double sum = 0.0;
  for (const double w : weights) sum += w;
  for (double& w : weights) w /= sum;
  return weights;
}

// The shape with its quads cut along a diagonal.
inline Shape triangulated(Shape shape) {
  for (size_t q = 0; q < shape.quads.size(); q += 4) {
    const uint32_t* c = shape.quads.data() + q;
    shape.triangles.insert(shape.triangles.end(), {c[0], c[1], c[2], c[0], c[2], c[3]});
  }
  shape.quads.clear();
  return shape;
}

inline std::vector<double> polygon_mean_value(const Shape& shape, const Vec<2>& x) {
  std::vector<double> weights(shape.vertex_count(), 0.0);
  for (size_t s = 0; s < shape.segments.size(); s += 2) {
    const uint32_t i = shape.segments[s], j = shape.segments[s + 1];
    const Vec<2> a = vertex_of<2>(shape, i) - x, b = vertex_of<2>(shape, j) - x;
    const double angle = std::atan2(a[0] * b[1] - a[1] * b[0], a.dot(b));
    weights[i] += std::tan(angle / 2) / a.norm();
    weights[j] += std::tan(angle / 2) / b.norm();
  }
  return normalized(weights);
}

inline std::vector<double> mesh_mean_value(const Shape& shape, const Vec<3>& x) {
  std::vector<double> weights(shape.vertex_count(), 0.0);
  for (size_t t = 0; t < shape.triangles.size(); t += 3) {
    double distance[3], angle[3], sine[3], cosine[3];
    Vec<3> u[3];
    for (size_t i = 0; i < 3; ++i) {
      const Vec<3> to = vertex_of<3>(shape, shape.triangles[t + i]) - x;
      distance[i] = to.norm();
      u[i] = to / distance[i];
    }
    for (size_t i = 0; i < 3; ++i)
      angle[i] = 2 * std::asin(std::min(1.0, (u[(i + 1) % 3] - u[(i + 2) % 3]).norm() / 2));
    const double half = (angle[0] + angle[1] + angle[2]) / 2;
    const double orientation = u[0].dot(u[1].cross(u[2])) < 0 ? -1.0 : 1.0;
    bool in_plane = false;
    for (size_t i = 0; i < 3; ++i) {
      cosine[i] = 2 * std::sin(half) * std::sin(half - angle[i]) /
                      (std::sin(angle[(i + 1) % 3]) * std::sin(angle[(i + 2) % 3])) -
                  1;
      sine[i] = orientation * std::sqrt(std::max(0.0, 1 - cosine[i] * cosine[i]));
      in_plane = in_plane || std::abs(sine[i]) < 1e-9;
    }
    if (in_plane) continue;
    for (size_t i = 0; i < 3; ++i) {
      const size_t next = (i + 1) % 3, last = (i + 2) % 3;
      weights[shape.triangles[t + i]] += (angle[i] - cosine[next] * angle[last] - cosine[last] * angle[next]) /
                                         (distance[i] * std::sin(angle[next]) * sine[last]);
    }
  }
  return normalized(weights);
}

}  // namespace barycast::testing
