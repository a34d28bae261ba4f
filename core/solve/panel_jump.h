#pragma once

// By how much the potentials of the inside differ on the two sides of a panel: continued from below it, they go on as
// if the panel were not there. Across it that of dipoles falls by their density, and the outward slope of that of
// charges by 4 pi times theirs; both are linear on the panel, and so the continuations exact.

#include <array>
#include <optional>

#include "solve/boundary_data.h"
#include "solve/density_groups.h"
#include "solve/double_layer.h"
#include "solve/panels.h"

namespace barycast {

// How much of the jump a point lacks that counts as inside, by -D[1] there: none inside the panels, all of it beyond
// them, some on a panel.
inline double outside_part(double enclosed) {
  return enclosed > 0.75 ? 0.0 : enclosed < 0.25 ? 1.0 : 1 - enclosed;
}

struct PanelJump {
  BoundaryData::Row value;                    // of the columns of the basis
  std::array<BoundaryData::Row, 3> gradient;  // of it
};

// At x, across the panel that y lies on, or over; none where its element has none. densities: of the inside.
// orientation: of the cage.
std::optional<PanelJump> jump_across_panel(const Panels& panels, const DoubleLayer& dipoles,
                                           const DensityGroups& densities, const BoundaryData& data, double orientation,
                                           const CagePoint<3>& y, const Vec<3>& x);

}  // namespace barycast
