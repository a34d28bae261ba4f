#pragma once

// Random directions, lattices of them, and the exact law of where a walk from outside first meets a sphere
// about the origin. All from a few uniform numbers, in double, with a sine and cosine of our own so that
// bits do not depend on the system's mathematics library.

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "base/vector.h"

namespace barycast {

struct SineCosine {
  double sine, cosine;
};

// Of 2 pi turns, turns in [0, 1]; error below 1e-15 (Taylor series about the nearest quarter turn).
inline SineCosine sine_cosine_of_turns(double turns) {
  const double quarter = std::nearbyint(4 * turns);
  const double x = (turns - 0.25 * quarter) * (2 * std::numbers::pi), x2 = x * x;
  double s = -1.0 / 1307674368000;
  for (const double divisor : {6227020800.0, -39916800.0, 362880.0, -5040.0, 120.0, -6.0}) s = s * x2 + 1.0 / divisor;
  s = (s * x2 + 1.0) * x;
  double c = 1.0 / 20922789888000;
  for (const double divisor : {-87178291200.0, 479001600.0, -3628800.0, 40320.0, -720.0, 24.0, -2.0})
    c = c * x2 + 1.0 / divisor;
  c = c * x2 + 1.0;
  // A quarter turn swaps sine and cosine, and flips signs; without branches, for vector code.
  const int turn = static_cast<int>(quarter);
  const bool swap = (turn & 1) != 0;
  return {((turn & 2) != 0 ? -1.0 : 1.0) * (swap ? c : s), (((turn + 1) & 2) != 0 ? -1.0 : 1.0) * (swap ? s : c)};
}

// Where Brownian motion from x, |x| > radius, first meets the sphere of that radius about the origin,
// given that it does: the exterior Poisson kernel, by inversion of its distribution function. In the
// plane it always does; in space with probability radius / |x|.
template <int D>
Vec<D> exterior_hit(const Vec<D>& x, double radius, const std::array<double, 2>& random) {
  const double distance = x.norm(), rho = radius / distance;
  const Vec<D> axis = x / distance;
  if constexpr (D == 2) {
    // tan(theta / 2) = (1 - rho) / (1 + rho) tan(pi (random - 1/2)), as a rotation by theta.
    const SineCosine half = sine_cosine_of_turns(0.5 * random[0]);
    const double s = -(1 - rho) * half.cosine, c = (1 + rho) * half.sine;
    const double scale = 1 / (s * s + c * c);
    const double cosine = (c * c - s * s) * scale, sine = 2 * s * c * scale;
    return radius * Vec<2>(axis[0] * cosine - axis[1] * sine, axis[1] * cosine + axis[0] * sine);
  } else {
    // cos(theta) = (1 + rho^2 - t^2) / (2 rho) with t = (1 - rho^2) / (1 - rho + 2 rho random), written
    // without the cancellation at small rho.
    const double denominator = 1 - rho + 2 * rho * random[0];
    const double t = (1 - rho * rho) / denominator;
    const double cosine = std::clamp(0.5 * ((2 * random[0] - 1 + rho) * (1 + t) / denominator + rho), -1.0, 1.0);
    const double sine = std::sqrt(1 - cosine * cosine);
    const Vec<3> helper = std::abs(axis[0]) < 0.5 ? Vec<3>::UnitX() : Vec<3>::UnitY();
    const Vec<3> tangent0 = axis.cross(helper).normalized(), tangent1 = axis.cross(tangent0);
    const SineCosine around = sine_cosine_of_turns(random[1]);
    return radius * (cosine * axis + sine * (around.cosine * tangent0 + around.sine * tangent1));
  }
}

// A cone of directions: those that make an angle with `axis` whose cosine is at least 1 - depth. `depth` is
// exact for narrow cones as well; 2: all directions.
template <int D>
struct Cone {
  Vec<D> axis;
  double depth;

  // The direction at a fraction of the cone's measure (D = 3: of its area, outwards from the axis; D = 2: of
  // its angle, from one side to the other), turned around the axis.
  Vec<D> direction(double fraction, double turns) const {
    if constexpr (D == 2) {
      // By the half angle's sine: acos(1 - depth) would lose narrow cones.
      const double half_angle = 2 * std::asin(std::sqrt(std::min(1.0, 0.5 * depth)));
      const double turn = (2 * fraction - 1) * half_angle / (2 * std::numbers::pi);
      const SineCosine angle = sine_cosine_of_turns(turn < 0 ? turn + 1 : turn);
      return {axis[0] * angle.cosine - axis[1] * angle.sine, axis[1] * angle.cosine + axis[0] * angle.sine};
    } else {
      const double s = fraction * depth;
      const double sine = std::sqrt(std::max(0.0, s * (2 - s)));
      const SineCosine around = sine_cosine_of_turns(turns);
      const Vec<3> helper = std::abs(axis[0]) < 0.5 ? Vec<3>::UnitX() : Vec<3>::UnitY();
      const Vec<3> tangent0 = axis.cross(helper).normalized(), tangent1 = axis.cross(tangent0);
      return ((1 - s) * axis + sine * (around.cosine * tangent0 + around.sine * tangent1)).normalized();
    }
  }
};

// The part of a golden-ratio sequence that matters: i times the golden ratio, modulo one, plus a shift.
inline double golden_turns(uint32_t i, double shift) {
  const double turns = i * 0.6180339887498949 + shift;
  return turns - std::floor(turns);
}

// A rotation, uniform over all of them, from three (D = 2: one) uniform numbers [Shoemake 1992].
template <int D>
Mat<D> uniform_rotation(const std::array<double, 2>& first, const std::array<double, 2>& second) {
  if constexpr (D == 2) {
    const SineCosine angle = sine_cosine_of_turns(first[0]);
    Mat<2> rotation;
    rotation << angle.cosine, -angle.sine, angle.sine, angle.cosine;
    return rotation;
  } else {
    const SineCosine a = sine_cosine_of_turns(first[1]), b = sine_cosine_of_turns(second[0]);
    const double r = std::sqrt(1 - first[0]), q = std::sqrt(first[0]);
    return Eigen::Quaterniond(q * b.cosine, r * a.sine, r * a.cosine, q * b.sine).toRotationMatrix();
  }
}

}  // namespace barycast
