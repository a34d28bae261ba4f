#pragma once

// Densities of the boundary elements: a row per point of a panel, columns in groups that are solved and summed
// together. The columns of the basis start a group and so do those of the moments: inside closed cages only the first
// are needed.

#include <vector>

#include "solve/boundary_data.h"
#include "solve/tiled_cholesky.h"

namespace barycast {

inline constexpr Eigen::Index kDensityGroup = 16;
using DensityGroups = std::vector<TiledCholesky::Columns>;
struct DensityColumn {
  size_t group;
  Eigen::Index lane;
  DensityColumn(Eigen::Index column, const BoundaryData& data) {
    const bool basis = column < data.basis_count();
    const Eigen::Index local = basis ? column : column - data.basis_count();
    group = static_cast<size_t>(local / kDensityGroup) + (basis ? 0 : groups(data.basis_count()));
    lane = local % kDensityGroup;
  }
  static size_t groups(Eigen::Index columns) {
    return static_cast<size_t>((columns + kDensityGroup - 1) / kDensityGroup);
  }
  static size_t groups(const BoundaryData& data) {
    return groups(data.basis_count()) + groups(data.count() - data.basis_count());
  }
};

}  // namespace barycast
