#pragma once

// Mean value coordinates by quadrature, the reference for everything else: it shares no formula with the library's
// estimators. Of closed cages of any elements:
//   w_v = int phi_v(y) N . (y - x) / |y - x|^4 du dv,  N = y_u x y_v,
// over every triangle and bilinear patch, normalized. A part that reaches from its middle farther than half its
// middle's distance from x is cut in four, others take 10 x 10 Gauss-Legendre points: an error of 1e-14 of the part.
// Measured against the closed form on triangles: coordinates to 1e-12 within a diagonal, and to 1e-14 on the way to a
// face, from 1e-2 to 1e-12 diagonals away from it; cutting stops 1e-12 away. Far away the weights cancel: 1e-12 |x| of
// the row.

#include <algorithm>
#include <array>
#include <vector>

#include "cage/cage.h"

namespace barycast::testing {

class MeanValueQuadrature {
 public:
  explicit MeanValueQuadrature(const Cage<3>& cage) : cage_(cage) {}

  // Coordinates of x (normalized frame), dense over the control vertices.
  std::vector<double> operator()(const Vec<3>& x) const {
    std::vector<double> weights(cage_.control_vertex_count(), 0.0);
    for (const Element& element : cage_.elements()) {
      Corners to;  // a triangle is a patch whose last two corners are one
      for (int i = 0; i < 4; ++i)
        to[static_cast<size_t>(i)] = cage_.corner(element, std::min(i, element.corner_count() - 1)) - x;
      std::array<double, 4> shares{};
      add(to, {0.0, 0.0, 1.0, 0}, shares);
      for (size_t i = 0; i < 4; ++i)
        for (const auto& [vertex, share] :
             cage_.stencil(element.node[std::min<size_t>(i, static_cast<size_t>(element.corner_count() - 1))]))
          weights[vertex] += share * shares[i];
    }
    double total = 0.0;
    for (const double w : weights) total += w;
    for (double& w : weights) w /= total;
    return weights;
  }

 private:
  using Corners = std::array<Vec<3>, 4>;
  struct Part {
    double u, v, size;
    int depth;
  };
  static constexpr int kDepthMax = 40;

  static std::array<double, 4> shares_at(double u, double v) {
    return {(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v};
  }
  static Vec<3> at(const Corners& to, double u, double v) {
    const auto s = shares_at(u, v);
    return s[0] * to[0] + s[1] * to[1] + s[2] * to[2] + s[3] * to[3];
  }

  // Adds the integrals of the four shares over a part.
  static void add(const Corners& to, const Part& part, std::array<double, 4>& sums) {
    const double half = part.size / 2;
    const Vec<3> middle = at(to, part.u + half, part.v + half);
    double reach = 0.0;  // the corners of a part of a bilinear patch are its farthest points
    for (const double u : {part.u, part.u + part.size})
      for (const double v : {part.v, part.v + part.size}) reach = std::max(reach, (at(to, u, v) - middle).norm());
    if (2 * reach > middle.norm() && part.depth < kDepthMax) {
      for (const double u : {part.u, part.u + half})
        for (const double v : {part.v, part.v + half}) add(to, {u, v, half, part.depth + 1}, sums);
      return;
    }
    constexpr double kNode[5] = {0.14887433898163122, 0.43339539412924719, 0.67940956829902441, 0.86506336668898451,
                                 0.97390652851717172};
    constexpr double kWeight[5] = {0.29552422471475287, 0.26926671930999635, 0.21908636251598204, 0.14945134915058059,
                                   0.066671344308688138};
    for (int i = 0; i < 10; ++i)
      for (int j = 0; j < 10; ++j) {
        const double u = part.u + half * (1 + (i % 2 == 0 ? 1 : -1) * kNode[i / 2]);
        const double v = part.v + half * (1 + (j % 2 == 0 ? 1 : -1) * kNode[j / 2]);
        const Vec<3> y = at(to, u, v);
        const Vec<3> along_u = (1 - v) * (to[1] - to[0]) + v * (to[2] - to[3]);
        const Vec<3> along_v = (1 - u) * (to[3] - to[0]) + u * (to[2] - to[1]);
        const double squared = y.squaredNorm();
        const double density = half * half * kWeight[i / 2] * kWeight[j / 2] * along_u.cross(along_v).dot(y);
        const auto shares = shares_at(u, v);
        for (size_t k = 0; k < 4; ++k) sums[k] += shares[k] * density / (squared * squared);
      }
  }

  const Cage<3>& cage_;
};

}  // namespace barycast::testing
