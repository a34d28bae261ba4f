#include "solve/panel_kernels.h"

#include "solve/panel_potential.h"

namespace barycast {
namespace {

// Distances, in radii of a panel, from which seven points and three points stand for it.
constexpr double kSevenPointRadii = 5.0;
constexpr double kThreePointRadii = 12.0;

}  // namespace

PanelKernels::PanelKernels(Panels panels)
    : panels_(std::move(panels)),
      points_(3 * panels_.panels.size(), 3),
      normals_(3 * panels_.panels.size(), 3),
      charge_(3 * panels_.panels.size()) {
  for (size_t p = 0; p < panels_.panels.size(); ++p)
    for (size_t k = 0; k < 3; ++k) {
      const auto at = static_cast<Eigen::Index>(3 * p + k);
      points_.row(at) = panels_.panels[p].point[k].transpose().array();
      normals_.row(at) = panels_.panels[p].normal.transpose().array();
      charge_[at] = panels_.panels[p].area / 3;
    }
}

size_t PanelKernels::bytes() const {
  return panels_.panels.size() * sizeof(Panel) + static_cast<size_t>(charge_.size()) * 7 * sizeof(double);
}

// Far panels as three points, all at once; then what is nearer, panel by panel.
void PanelKernels::fill(const Vec<3>& x, Eigen::Index row, bool gradient, bool dipoles, Tables& out) const {
  const Eigen::ArrayXd dx = points_.col(0) - x[0], dy = points_.col(1) - x[1], dz = points_.col(2) - x[2];
  const Eigen::ArrayXd inverse_squared = (dx.square() + dy.square() + dz.square()).inverse();
  const Eigen::ArrayXd value = charge_ * inverse_squared.sqrt(), rate = value * inverse_squared;
  const Eigen::ArrayXd* const to[3] = {&dx, &dy, &dz};
  out.charges.row(row) = value.matrix().transpose();
  for (Eigen::Index i = 0; gradient && i < 3; ++i) out.charges.row(1 + i) = (rate * *to[i]).matrix().transpose();
  if (dipoles) {
    const Eigen::ArrayXd height = -(normals_.col(0) * dx + normals_.col(1) * dy + normals_.col(2) * dz);
    out.dipoles.row(row) = (height * rate).matrix().transpose();
    if (gradient) {
      const Eigen::ArrayXd along = 3 * height * inverse_squared;
      for (Eigen::Index i = 0; i < 3; ++i)
        out.dipoles.row(1 + i) = (rate * (normals_.col(i) + along * *to[i])).matrix().transpose();
    }
  }
  PanelPotential potential;
  for (size_t p = 0; p < panels_.panels.size(); ++p) {
    const Panel& panel = panels_.panels[p];
    const double distance_squared = (panel.centre - x).squaredNorm(), radius_squared = panel.radius * panel.radius;
    if (distance_squared > kThreePointRadii * kThreePointRadii * radius_squared) continue;
    if (distance_squared > kSevenPointRadii * kSevenPointRadii * radius_squared) {
      far_potential(panel, x, gradient, potential);
    } else {
      exact_potential(panel, x, gradient, potential);
    }
    const auto at = static_cast<Eigen::Index>(3 * p);
    out.charges.block<1, 3>(row, at) = potential.value.transpose();
    if (dipoles) out.dipoles.block<1, 3>(row, at) = potential.dipole.transpose();
    for (Eigen::Index k = 0; gradient && k < 3; ++k) {
      out.charges.block<3, 1>(1, at + k) = potential.gradient[static_cast<size_t>(k)];
      if (dipoles) out.dipoles.block<3, 1>(1, at + k) = potential.dipole_gradient[static_cast<size_t>(k)];
    }
  }
}

}  // namespace barycast
