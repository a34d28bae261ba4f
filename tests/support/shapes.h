#pragma once

// Small cages for tests, made by formula: what each is good for is said beside it.

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <utility>
#include <vector>

#include "cage/cage.h"

namespace barycast::testing {

// Owns what a CageInput borrows.
struct Shape {
  int dimension = 3;
  std::vector<double> vertices{};
  std::vector<uint32_t> segments{}, triangles{}, quads{}, polygon_offsets{}, polygon_corners{};

  CageInput input() const {
    return {dimension, vertices, segments, triangles, quads, polygon_offsets, polygon_corners};
  }
  size_t vertex_count() const { return vertices.size() / static_cast<size_t>(dimension); }
  // Applies a function to every vertex.
  template <class Map>
  Shape mapped(const Map& map) const {
    Shape result = *this;
    const auto d = static_cast<size_t>(dimension);
    for (size_t v = 0; v < vertex_count(); ++v) {
      Eigen::VectorXd x = Eigen::Map<const Eigen::VectorXd>(vertices.data() + v * d, dimension);
      const Eigen::VectorXd y = map(x);
      for (size_t k = 0; k < d; ++k) result.vertices[v * d + k] = y[static_cast<Eigen::Index>(k)];
    }
    return result;
  }
};

// A simplex: every kind of coordinates is affine on it.
inline Shape tetrahedron() {
  return {.vertices = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}, .triangles = {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3}};
}

// The cube [-1, 1]^3 of six planar quads: harmonic coordinates are trilinear. Vertex 4 i + 2 j + k at
// (2 i - 1, 2 j - 1, 2 k - 1).
inline Shape box() {
  Shape shape;
  for (int v = 0; v < 8; ++v)
    for (int bit : {4, 2, 1}) shape.vertices.push_back((v & bit) != 0 ? 1.0 : -1.0);
  shape.quads = {0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3};
  return shape;
}

// Both, as one cage.
inline Shape joined(const Shape& a, const Shape& b) {
  Shape shape = a;
  const auto first = static_cast<uint32_t>(a.vertices.size() / a.dimension);
  shape.vertices.insert(shape.vertices.end(), b.vertices.begin(), b.vertices.end());
  for (const uint32_t v : b.triangles) shape.triangles.push_back(first + v);
  for (const uint32_t v : b.quads) shape.quads.push_back(first + v);
  return shape;
}

// A closed cage with dihedral angles of some degrees.
inline Shape flat_tetrahedron() {
  return {.vertices = {0, 0, 0, 1, 0, 0, 0.5, 1, 0, 0.5, 0.3, 0.03}, .triangles = {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3}};
}

// A box whose upper and lower side nearly meet.
inline Shape thin_box() {
  Shape shape = box();
  for (size_t i = 2; i < shape.vertices.size(); i += 3) shape.vertices[i] *= 1e-3;
  return shape;
}

// The box of triangles, as quads whose last two corners are one.
inline Shape collapsed_box() {
  Shape shape = box();
  const std::vector<uint32_t> quads = std::exchange(shape.quads, {});
  for (size_t q = 0; q < quads.size(); q += 4)
    for (const size_t k : {0u, 1u, 2u, 2u, 0u, 2u, 3u, 3u}) shape.quads.push_back(quads[q + k]);
  return shape;
}

// A box of half the size about a point.
inline Shape small_box(double x, double y, double z) {
  Shape shape = box();
  for (size_t i = 0; i < shape.vertices.size(); ++i)
    shape.vertices[i] = 0.5 * shape.vertices[i] + std::array{x, y, z}[i % 3];
  return shape;
}

// Closed, non-convex (an L of three cells), with bilinear, non-planar quads.
inline Shape bent_prism() {
  Shape shape;
  const double corner[8][2] = {{0, 0}, {1, 0}, {2, 0}, {2, 1}, {1, 1}, {1, 2}, {0, 2}, {0, 1}};
  for (int z = 0; z < 2; ++z)
    for (const auto& c : corner) {
      const double wobble = 0.15 * std::sin(3 * c[0] + 5 * c[1] + 2 * z);
      shape.vertices.insert(shape.vertices.end(), {c[0] + wobble, c[1] - wobble, z + 1.5 * wobble});
    }
  for (uint32_t i = 0; i < 8; ++i) {
    const uint32_t j = (i + 1) % 8;
    shape.quads.insert(shape.quads.end(), {i, j, j + 8, i + 8});
  }
  for (const auto& cell : {std::array<uint32_t, 4>{0, 1, 4, 7}, {1, 2, 3, 4}, {7, 4, 5, 6}}) {
    shape.quads.insert(shape.quads.end(), {cell[3], cell[2], cell[1], cell[0]});
    for (const uint32_t v : cell) shape.quads.push_back(v + 8);
  }
  return shape;
}

// A pentagonal prism: pentagons above and below, triangles and quads around. All kinds mixed.
inline Shape mixed_prism() {
  Shape shape;
  for (int z = 0; z < 2; ++z)
    for (int i = 0; i < 5; ++i) {
      const double angle = 2 * std::numbers::pi * (i + 0.3 * z) / 5;
      shape.vertices.insert(shape.vertices.end(), {std::cos(angle), std::sin(angle), 1.5 * z + 0.1 * i * z});
    }
  shape.polygon_offsets = {0, 5, 10};
  shape.polygon_corners = {4, 3, 2, 1, 0, 5, 6, 7, 8, 9};
  for (uint32_t i = 0; i < 5; ++i) {
    const uint32_t j = (i + 1) % 5;
    if (i % 2 == 0) {
      shape.quads.insert(shape.quads.end(), {i, j, j + 5, i + 5});
    } else {
      shape.triangles.insert(shape.triangles.end(), {i, j, j + 5, i, j + 5, i + 5});
    }
  }
  return shape;
}

// The box without its top: an open cage.
inline Shape open_box() {
  Shape shape = box();
  shape.quads.resize(5 * 4);
  return shape;
}

// Unconnected triangles around the origin, facing anyhow.
inline Shape soup() {
  Shape shape;
  for (uint32_t t = 0; t < 12; ++t) {
    const double z = 1 - (2 * t + 1) / 12.0, r = std::sqrt(1 - z * z), angle = 2.4 * t;
    const Eigen::Vector3d centre(r * std::cos(angle), r * std::sin(angle), z);
    const Eigen::Vector3d a = centre.unitOrthogonal(), b = centre.cross(a);
    for (int k = 0; k < 3; ++k) {
      const double turn = 2 * std::numbers::pi * k / 3 + t;
      const Eigen::Vector3d x = centre + 0.5 * (std::cos(turn) * a + std::sin(turn) * b);
      shape.vertices.insert(shape.vertices.end(), {x[0], x[1], x[2]});
    }
    shape.triangles.insert(shape.triangles.end(),
                           {3 * t, 3 * t + (t % 2 != 0u ? 2u : 1u), 3 * t + (t % 2 != 0u ? 1u : 2u)});
  }
  return shape;
}

// A closed, non-convex polygon in the plane.
inline Shape star_polygon() {
  Shape shape{.dimension = 2};
  for (uint32_t i = 0; i < 10; ++i) {
    const double angle = 2 * std::numbers::pi * i / 10, r = i % 2 == 0 ? 1.0 : 0.55;
    shape.vertices.insert(shape.vertices.end(), {r * std::cos(angle), r * std::sin(angle)});
    shape.segments.insert(shape.segments.end(), {i, (i + 1) % 10});
  }
  return shape;
}

// The square [-1, 1]^2: harmonic coordinates are bilinear.
inline Shape square() {
  return {.dimension = 2, .vertices = {-1, -1, 1, -1, 1, 1, -1, 1}, .segments = {0, 1, 1, 2, 2, 3, 3, 0}};
}

// A sphere of n x 2n quads (triangles at the poles), radius r: a query mesh, or a large triangle cage.
inline Shape sphere(int n, double radius) {
  Shape shape;
  shape.vertices = {0, 0, radius};
  for (int i = 1; i < n; ++i)
    for (int j = 0; j < 2 * n; ++j) {
      const double polar = std::numbers::pi * i / n, around = std::numbers::pi * j / n;
      shape.vertices.insert(shape.vertices.end(),
                            {radius * std::sin(polar) * std::cos(around), radius * std::sin(polar) * std::sin(around),
                             radius * std::cos(polar)});
    }
  shape.vertices.insert(shape.vertices.end(), {0, 0, -radius});
  const auto ring = static_cast<uint32_t>(2 * n), last = static_cast<uint32_t>(shape.vertices.size() / 3 - 1);
  for (uint32_t j = 0; j < ring; ++j) {
    const uint32_t k = (j + 1) % ring;
    shape.triangles.insert(shape.triangles.end(), {0, 1 + j, 1 + k});
    shape.triangles.insert(shape.triangles.end(), {last, last - ring + k, last - ring + j});
    for (uint32_t i = 0; i + 2 < static_cast<uint32_t>(n); ++i)
      shape.quads.insert(shape.quads.end(),
                         {1 + i * ring + j, 1 + (i + 1) * ring + j, 1 + (i + 1) * ring + k, 1 + i * ring + k});
  }
  return shape;
}

}  // namespace barycast::testing
