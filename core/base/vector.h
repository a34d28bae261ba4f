#pragma once

// Vectors and small matrices. `D` is the dimension of space, 2 or 3; homogeneous vectors have D + 1
// entries, the last one is the constant.

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace barycast {

template <int D>
using Vec = Eigen::Matrix<double, D, 1>;
template <int D>
using Mat = Eigen::Matrix<double, D, D>;

// [x; 1]
template <int D>
Vec<D + 1> homogeneous(const Vec<D>& x) {
  Vec<D + 1> result;
  result.template head<D>() = x;
  result[D] = 1.0;
  return result;
}

}  // namespace barycast
