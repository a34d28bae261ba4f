#pragma once

// From the moments of a measure on the cage, known as functions of the query, to coordinates: the projection
// [SBC Eq. 7 to 10] and its exact derivative. The field that coordinates are outside and for open cages.

#include "solve/boundary_data.h"

namespace barycast {

// `moments`: columns of BoundaryData at x, `slopes` their gradients (each row empty where not asked for). Writes
// control_vertices values, and gradients likewise. False: the moments do not span space, and what is missing was
// left out.
bool project_moments(const Vec<3>& x, const BoundaryData::Row& moments, const std::array<BoundaryData::Row, 3>& slopes,
                     Eigen::Index control_vertices, Eigen::Ref<BoundaryData::Row> values,
                     std::array<BoundaryData::Row, 3>& gradients);

}  // namespace barycast
