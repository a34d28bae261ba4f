#pragma once

// What the boundary elements solve for: functions known on the cage, one column each. The basis phi_v of every
// control vertex; with moments also phi_v z and z z^T, from which the projection [SBC Eq. 7 to 10] makes the
// coordinates outside and for open cages. z is a point y of the cage in a frame in which the control vertices spread
// equally in all directions. The projection is the same in all frames; its rounding is not: of a thin cage y y^T would
// have lost the thin direction.

#include <vector>

#include "cage/cage.h"
#include "query/distance_index.h"

namespace barycast {

class BoundaryData {
 public:
  BoundaryData(const Cage<3>& cage, bool moments);

  // Columns, n being the number of used control vertices: phi_v of each, then (moments) phi_v z_0, phi_v z_1, phi_v z_2
  // for each, then z_0 z_0, z_0 z_1, z_0 z_2, z_1 z_1, z_1 z_2, z_2 z_2.
  Eigen::Index basis_count() const { return static_cast<Eigen::Index>(cage_.used_vertices().size()); }
  Eigen::Index count() const { return moments_ ? 4 * basis_count() + 6 : basis_count(); }
  bool has_moments() const { return moments_; }
  Eigen::Index column(uint32_t used_vertex) const { return column_of_vertex_[used_vertex]; }

  // From the normalized frame to that of the moments: of points, and of directions.
  Vec<3> to_moments(const Vec<3>& y) const { return spread_ * (y - centre_); }
  const Mat<3>& direction_to_moments() const { return spread_; }

  using Row = Eigen::Matrix<double, 1, Eigen::Dynamic, Eigen::RowMajor>;
  struct Entry {
    Eigen::Index column;
    double value;
  };

  // What is not zero at a point of the cage; a column may occur more than once. Replaces what `out` held.
  void entries(uint32_t element, const std::array<double, 4>& shares, const Vec<3>& y, std::vector<Entry>& out) const;
  // The same as a row, of the first `out.size()` columns.
  void values(uint32_t element, const std::array<double, 4>& shares, const Vec<3>& y, Eigen::Ref<Row> out) const;

  // Derivatives along the cage, as vectors, at the closest point y of a query: in the tangent plane on a face, along
  // the edge on an edge, 0 at a corner. `tangent` projects on the same directions.
  void gradients(const CagePoint<3>& y, std::array<Row, 3>& out, Mat<3>& tangent) const;

 private:
  const Cage<3>& cage_;
  bool moments_;
  Vec<3> centre_ = Vec<3>::Zero();
  Mat<3> spread_ = Mat<3>::Identity();
  std::vector<Eigen::Index> column_of_vertex_;
};

}  // namespace barycast
