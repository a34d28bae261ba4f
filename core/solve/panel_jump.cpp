#include "solve/panel_jump.h"

#include <numbers>

namespace barycast {

std::optional<PanelJump> jump_across_panel(const Panels& panels, const DoubleLayer& dipoles,
                                           const DensityGroups& densities, const BoundaryData& data, double orientation,
                                           const CagePoint<3>& y, const Vec<3>& x) {
  const std::optional<size_t> p = dipoles.panel_at(panels, y);
  if (!p) return std::nullopt;
  const Panel& panel = panels.panels[*p];
  const Vec<3> outward = orientation * panel.normal;
  const double height = outward.dot(x - panel.centre), charge_factor = 4 * std::numbers::pi;
  PanelJump jump;
  jump.value.setZero(data.basis_count());
  for (BoundaryData::Row& partial : jump.gradient) partial.setZero(data.basis_count());
  BoundaryData::Row charges(data.basis_count());
  for (size_t k = 0; k < 3; ++k) {
    const size_t point = 3 * *p + k;
    const BoundaryData::Row density = dipoles.at(point);
    for (Eigen::Index v = 0; v < charges.size(); ++v) {
      const DensityColumn at(v, data);
      charges[v] = charge_factor * densities[at.group](static_cast<Eigen::Index>(point), at.lane);
    }
    const double share = 1 / 3.0 + panel.gradient[k].dot(x - panel.centre);
    const BoundaryData::Row continued = density + height * charges;
    jump.value += share * continued;
    for (size_t i = 0; i < 3; ++i) {
      const auto axis = static_cast<Eigen::Index>(i);
      jump.gradient[i] += panel.gradient[k][axis] * continued + share * outward[axis] * charges;
    }
  }
  return jump;
}

}  // namespace barycast
