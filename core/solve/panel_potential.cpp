#include "solve/panel_potential.h"

#include <algorithm>
#include <cmath>

namespace barycast {
namespace {

// Distances, in sums of both radii, from which pairs of panels are integrated by points on both: three on each, seven
// on each. Nearer than that one side is exact.
constexpr double kThreePointDistance = 6.0;
constexpr double kSevenPointDistance = 2.0;
// Keeps logarithms and quotients finite for points on the line of an edge; far below what rounding leaves of them.
constexpr double kTiny = 1e-200;

Vec<3> at(const Panel& panel, const std::array<double, 3>& barycentric) {
  return barycentric[0] * panel.corner[0] + barycentric[1] * panel.corner[1] + barycentric[2] * panel.corner[2];
}

// The density functions where the barycentric coordinates are these.
Vec<3> density_functions(const std::array<double, 3>& barycentric) {
  return 2 * Vec<3>(barycentric[0], barycentric[1], barycentric[2]) - Vec<3>::Constant(1 / 3.0);
}

// An edge as seen from x: integrals along it, in the panel's plane about the projection of x.
struct EdgeIntegrals {
  Vec<3> along, outward;  // unit vectors in the plane
  double distance;        // of the projection from the edge's line, positive inside
  double inverse;         // int dl / R
  double first;           // int l dl / R
  double radial;          // int R^2-weighted part of int (rho - rho_0) / R dA, see exact_potential
  double near;            // R where it starts
  double product;         // of the vectors to its ends
  Vec<3> inverse_slope;   // gradient of `inverse` in x
  double cube;            // int dl / R^3
};

// int dl / R^3 from `start` to `end` on a line at a distance, whose square is given; near and far are R there.
double inverse_cube(double start, double end, double near, double far, double line_squared) {
  // Along the line beside the edge the difference of both ends would cancel.
  if (start * end > 0) return (end - start) * (end + start) / ((end * near + start * far) * near * far);
  return (end / far - start / near) / std::max(line_squared, kTiny);
}

EdgeIntegrals edge_integrals(const Panel& panel, size_t edge, const Vec<3>& x, double height, bool with_gradient) {
  const Vec<3> from = panel.corner[edge] - x, to = panel.corner[(edge + 1) % 3] - x;
  EdgeIntegrals result;
  result.along = (to - from).normalized();
  result.outward = result.along.cross(panel.normal);
  result.distance = from.dot(result.outward);
  const double start = from.dot(result.along), end = to.dot(result.along);
  const double near = from.norm(), far = to.norm();  // of start and end
  const double line_squared = result.distance * result.distance + height * height;
  // ln((far + end) / (near + start)), written so that nothing cancels.
  if (start > 0) {
    result.inverse = std::log((far + end) / (near + start));
  } else if (end < 0) {
    result.inverse = std::log((near - start) / (far - end));
  } else {
    result.inverse = std::log(std::max((far + end) * (near - start), kTiny) / std::max(line_squared, kTiny));
  }
  result.first = far - near;
  result.radial = 0.5 * ((line_squared > 0 ? line_squared * result.inverse : 0.0) + end * far - start * near);
  result.near = near;
  result.product = from.dot(to);
  if (with_gradient) {
    result.cube = inverse_cube(start, end, near, far, line_squared);
    const Vec<3> to_line = result.distance * result.outward - height * panel.normal;
    result.inverse_slope = result.cube * to_line + (1 / near - 1 / far) * result.along;
  }
  return result;
}

}  // namespace

void exact_potential(const Panel& panel, const Vec<3>& x, bool with_gradient, PanelPotential& out) {
  const double height = panel.normal.dot(x - panel.centre);
  const Vec<3> projection = x - height * panel.normal;
  double inverse = 0.0;            // int 1 / R
  Vec<3> radial = Vec<3>::Zero();  // int (rho - rho_0) / R
  std::array<EdgeIntegrals, 3> edges;
  for (size_t i = 0; i < 3; ++i) {
    const EdgeIntegrals& e = edges[i] = edge_integrals(panel, i, x, height, with_gradient);
    inverse += e.distance * e.inverse;
    radial += e.radial * e.outward;
  }
  // |h| int 1 / R^3 [Van Oosterom, Strackee 1983].
  const double below = edges[0].near * edges[1].near * edges[2].near + edges[0].product * edges[2].near +
                       edges[1].product * edges[0].near + edges[2].product * edges[1].near;
  const double solid_angle = 2 * std::atan2(2 * panel.area * std::abs(height), below);
  inverse -= std::abs(height) * solid_angle;
  const double signed_angle = height > 0 ? solid_angle : height < 0 ? -solid_angle : 0.0;
  Vec<3> angle_slope = Vec<3>::Zero();
  if (with_gradient)
    for (const EdgeIntegrals& e : edges) angle_slope -= e.cube * (height * e.outward + e.distance * panel.normal);
  for (size_t k = 0; k < 3; ++k) {
    const Vec<3>& slope = panel.gradient[k];
    const auto at = static_cast<Eigen::Index>(k);
    const double value = 1 / 3.0 + slope.dot(projection - panel.centre);  // of the function, beyond the panel too
    out.value[at] = value * inverse + slope.dot(radial);
    out.dipole[at] = value * signed_angle;
    for (const EdgeIntegrals& e : edges) out.dipole[at] -= height * slope.dot(e.outward) * e.inverse;
    if (!with_gradient) continue;
    Vec<3> gradient = slope * inverse - out.dipole[at] * panel.normal;
    Vec<3> dipole_gradient = slope * signed_angle + value * angle_slope;
    for (const EdgeIntegrals& e : edges) {
      const double across = slope.dot(e.outward);
      gradient -= ((value + e.distance * across) * e.inverse + slope.dot(e.along) * e.first) * e.outward;
      dipole_gradient -= across * (e.inverse * panel.normal + height * e.inverse_slope);
    }
    out.gradient[k] = gradient;
    out.dipole_gradient[k] = dipole_gradient;
  }
}

void far_potential(const Panel& panel, const Vec<3>& x, bool with_gradient, PanelPotential& out) {
  out.value.setZero();
  out.dipole.setZero();
  if (with_gradient) out.gradient.fill(Vec<3>::Zero());
  if (with_gradient) out.dipole_gradient.fill(Vec<3>::Zero());
  const double height = panel.normal.dot(x - panel.centre);
  for (const TrianglePoint& rule : kTriangleRule) {
    const Vec<3> to = at(panel, rule.barycentric) - x;
    const double inverse = 1 / to.norm(), inverse_squared = inverse * inverse;
    const Vec<3> value = (rule.weight * panel.area * inverse) * density_functions(rule.barycentric);
    const Vec<3> rate = inverse_squared * value;
    out.value += value;
    out.dipole += height * rate;
    if (!with_gradient) continue;
    const Vec<3> dipole_direction = panel.normal + (3 * height * inverse_squared) * to;
    for (size_t k = 0; k < 3; ++k) {
      out.gradient[k] += rate[Eigen::Index(k)] * to;
      out.dipole_gradient[k] += rate[Eigen::Index(k)] * dipole_direction;
    }
  }
}

Mat<3> panel_interaction(const Panel& a, const Panel& b) {
  const double distance = (a.centre - b.centre).norm(), radii = a.radius + b.radius;
  Mat<3> result = Mat<3>::Zero();
  if (distance > kThreePointDistance * radii) {
    for (size_t j = 0; j < 3; ++j)
      for (size_t k = 0; k < 3; ++k)
        result(Eigen::Index(j), Eigen::Index(k)) = a.area * b.area / 9 / (a.point[j] - b.point[k]).norm();
    return result;
  }
  // Potentials of a large panel are smooth over a small one.
  const bool swapped = a.radius > b.radius;
  const Panel& outer = swapped ? b : a;
  const Panel& inner = swapped ? a : b;
  PanelPotential potential;
  for (const TrianglePoint& rule : kTriangleRule) {
    const Vec<3> x = at(outer, rule.barycentric);
    if (distance > kSevenPointDistance * radii) {
      far_potential(inner, x, false, potential);
    } else {
      exact_potential(inner, x, false, potential);
    }
    result += (rule.weight * outer.area * density_functions(rule.barycentric)) * potential.value.transpose();
  }
  if (swapped) result.transposeInPlace();
  return result;
}

}  // namespace barycast
