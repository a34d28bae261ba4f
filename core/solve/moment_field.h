#pragma once

// From the moments of a measure on the cage, known as functions of the query, to coordinates: the projection
// [SBC Eq. 7 to 10] and its exact derivative. The field that coordinates are outside and for open cages.

#include "solve/boundary_data.h"

namespace barycast {

class MomentProjection {
 public:
  // `moments`: columns of the data, at x (normalized frame). They must outlive the projection.
  MomentProjection(const BoundaryData& data, const Vec<3>& x, const BoundaryData::Row& moments);

  // False: the moments do not span space, and what is missing was left out.
  bool spans() const { return spans_; }
  // Of the measure.
  double mass() const { return mass_; }
  void values(Eigen::Ref<BoundaryData::Row> out) const;
  // What the values change by, to first order, where the point and the moments change by so much.
  void change(const Vec<3>& point, const BoundaryData::Row& moments, Eigen::Ref<BoundaryData::Row> out) const;

 private:
  const BoundaryData& data_;
  const BoundaryData::Row& moments_;
  double mass_;
  Vec<3> mean_;
  Mat<3> second_, inverse_;  // int z z^T; of the covariance
  Vec<3> q_;                 // inverse_ (that of x - mean_)
  bool spans_;
};

// `slopes`: gradients of the moments (each row empty where not asked for). Writes basis_count() values, and gradients
// likewise. False: as spans().
bool project_moments(const BoundaryData& data, const Vec<3>& x, const BoundaryData::Row& moments,
                     const std::array<BoundaryData::Row, 3>& slopes, Eigen::Ref<BoundaryData::Row> values,
                     std::array<BoundaryData::Row, 3>& gradients);

}  // namespace barycast
