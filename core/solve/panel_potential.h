#pragma once

// Potentials of one panel: of charges on it, int_T l_k(y) / |x - y| dA, and of dipoles along its normal n,
// int_T l_k(y) n . (x - y) / |x - y|^3 dA, for its three density functions, and their gradients in x. Exact, in
// double, everywhere: near the panel, in its plane, on it [Wilton et al. 1984, Graglia 1993]. On the panel the dipoles'
// potential and the normal part of the charges' gradient are the mean of both sides; at its edges the gradients are
// infinite, and come out large but finite. About 150 ns.

#include "solve/panels.h"

namespace barycast {

struct PanelPotential {
  Vec<3> value;                    // of charges, for each of the three functions
  std::array<Vec<3>, 3> gradient;  // of each
  Vec<3> dipole;                   // the same of dipoles
  std::array<Vec<3>, 3> dipole_gradient;
};

// Gradients are left alone unless asked for.
void exact_potential(const Panel& panel, const Vec<3>& x, bool with_gradient, PanelPotential& out);

// The same by the rule of seven points: relative error below 3e-6 (gradients 3e-5, dipoles 1e-4, and their gradients
// 3e-4) from five radii of the panel on.
void far_potential(const Panel& panel, const Vec<3>& x, bool with_gradient, PanelPotential& out);

// int int l_j(x) l_k(y) / |x - y| over two panels, or over one with itself.
Mat<3> panel_interaction(const Panel& a, const Panel& b);

}  // namespace barycast
