#pragma once

// Potentials of one panel: the integrals of its three density functions over the distance to a point,
// int_T l_k(y) / |x - y| dA, and their gradients in x. Exact, in double, everywhere: near the panel, in its plane,
// on it [Wilton et al. 1984, Graglia 1993]. On the panel the gradient's normal part is the mean of both sides; at
// its edges the gradient is infinite in the plane, and comes out large but finite. About 150 ns.

#include "solve/panels.h"

namespace barycast {

struct PanelPotential {
  Vec<3> value;                    // of the three functions
  std::array<Vec<3>, 3> gradient;  // of each
};

// The gradient is left alone unless asked for.
void exact_potential(const Panel& panel, const Vec<3>& x, bool with_gradient, PanelPotential& out);

// The same by the rule of seven points: relative error below 3e-6 (gradient 3e-5) from five radii of the panel on.
void far_potential(const Panel& panel, const Vec<3>& x, bool with_gradient, PanelPotential& out);

// int int l_j(x) l_k(y) / |x - y| over two panels, or over one with itself.
Mat<3> panel_interaction(const Panel& a, const Panel& b);

}  // namespace barycast
