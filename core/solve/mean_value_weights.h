#pragma once

// Mean value weights of a triangle mesh in closed form, four query points at a time: the inner loops of
// exact_mean_value.h, which says what they are good for.
//
// The weight of corner k of a triangle with unit normal n is w_k = int lambda_k(y) n . (y - x) / |y - x|^4 dA. Let a_k
// run from x to corner k, h = n . a_0 be the height of the plane over x, e_k the edge opposite to corner k, C_k the
// cross product of the a at its ends (twice the area of the triangle that it makes with x), theta_k the angle between
// them, p_k = n . C_k. Stokes turns the integral into integrals along the edges,
//   w_k = (p_k S / h + h Q_k) / (4 area),  S = sum_i p_i E_i,  Q_k = sum_i E_i e_i . e_k,  E_i = theta_i / |C_i|.
// E_i is all that costs, and is shared by the triangles of an edge. As sum_k w_k a_k = sum_i E_i C_i / 2, a closed mesh
// reproduces position but for rounding.

#include <array>
#include <cstdint>
#include <vector>

#include "cage/cage.h"

namespace barycast {

// The triangles of a cage and all that depends on them alone.
struct MeanValueMesh {
  struct Edge {
    uint32_t from, to;  // nodes
    double length;
  };
  struct Triangle {
    std::array<uint32_t, 3> node, edge;  // edge k is opposite to node k
    std::array<double, 3> sign;          // -1 where the triangle runs through its edge backwards
    std::array<double, 3> length;        // of its edges
    std::array<double, 3> product;       // e_i . e_k of the edges other than its own
    std::array<Vec<3>, 3> rise;          // gradient of p_k
    Vec<3> normal;
    double area;
  };
  std::vector<Vec<3>> nodes;
  std::vector<Edge> edges;
  std::vector<Triangle> triangles;

  explicit MeanValueMesh(const Cage<3>& cage);
  size_t bytes() const;
};

inline constexpr size_t kPointsAtOnce = 4;
using PointsAtOnce = std::array<Vec<3>, kPointsAtOnce>;

// Results and scratch; columns hold the values of the four points.
struct MeanValueSums {
  using Table = Eigen::Matrix<double, kPointsAtOnce, Eigen::Dynamic>;
  Table weights;    // per node
  Table gradients;  // per node and coordinate; empty unless asked for
  std::array<bool, kPointsAtOnce> on_cage;

  Table to_node;        // a, per node and coordinate
  Table cross;          // C, per edge and coordinate
  Table angle;          // E, per edge
  Table angle_slope;    // its gradient, per edge and coordinate
  Table fourth_moment;  // int |y - x|^-4 dl / length, per edge

  MeanValueSums(const MeanValueMesh& mesh, bool with_gradients);
};

// By the closed form. Points on the cage (kExactOnCage) are marked, and have no weights.
void add_near_weights(const MeanValueMesh& mesh, const PointsAtOnce& points, MeanValueSums& sums);

// By quadrature of the same integrals, for points beyond kExactFar, where the terms of the closed form cancel.
void add_far_weights(const MeanValueMesh& mesh, const PointsAtOnce& points, MeanValueSums& sums);

}  // namespace barycast
