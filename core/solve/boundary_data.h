#pragma once

// What the boundary elements solve for: functions known on the cage, one column each. The basis phi_v of every
// control vertex; with moments also phi_v y and y y^T, from which the projection [SBC Eq. 7 to 10] makes the
// coordinates outside and for open cages.

#include "cage/cage.h"
#include "query/distance_index.h"

namespace barycast {

class BoundaryData {
 public:
  BoundaryData(const Cage<3>& cage, bool moments) : cage_(cage), moments_(moments) {}

  // Columns: phi_v, then (moments) phi_v y_0, phi_v y_1, phi_v y_2 for every v, then y_0 y_0, y_0 y_1, y_0 y_2,
  // y_1 y_1, y_1 y_2, y_2 y_2.
  Eigen::Index basis_count() const { return cage_.control_vertex_count(); }
  Eigen::Index count() const { return moments_ ? 4 * basis_count() + 6 : basis_count(); }

  using Row = Eigen::Matrix<double, 1, Eigen::Dynamic, Eigen::RowMajor>;

  // The values at a point of the cage, for the first `columns` of them (either count).
  void values(uint32_t element, const std::array<double, 4>& shares, const Vec<3>& y, Eigen::Ref<Row> out) const;

  // Derivatives along the cage, as vectors, at the closest point y of a query: in the tangent plane on a face, along
  // the edge on an edge, 0 at a corner. `tangent` projects on the same directions.
  void gradients(const CagePoint<3>& y, std::array<Row, 3>& out, Mat<3>& tangent) const;

 private:
  const Cage<3>& cage_;
  bool moments_;
};

}  // namespace barycast
