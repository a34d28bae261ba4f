#pragma once

// Solid harmonics up to degree two: harmonic polynomials about the centre of a ball, orthonormal in the mean over its
// sphere. A harmonic function u is sum_j c_j b_j(x / R) inside, c_j the mean of b_j u over the sphere: by degrees,
//
//   u(x) = sum_l (2 l + 1) (|x| / R)^l mean_s[P_l(cos(x, s)) u(s)]
//
// the expansion of the Poisson kernel. What is left out is of third order in |x| / R.

#include <array>
#include <span>
#include <vector>

#include "base/vector.h"

namespace barycast {

inline constexpr size_t kHarmonics = 9;
using HarmonicValues = std::array<float, kHarmonics>;

// At a point of the unit ball.
HarmonicValues solid_harmonics(const Vec<3>& x);
// Their partial derivatives there.
std::array<HarmonicValues, 3> solid_harmonic_gradients(const Vec<3>& x);

// From values at directions to coefficients: c_j = sum_i factors[i][j] u(directions[i]). Least squares, which is the
// mean but for how unevenly the directions lie: polynomials are found exactly. Needs some dozen directions all around.
std::vector<HarmonicValues> harmonic_projection(std::span<const Vec<3>> directions);

}  // namespace barycast
