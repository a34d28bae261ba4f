#pragma once

// The border of the estimators that need no samples: coordinates as the solution of their equation, or as a
// closed form. They are the project's measuring instruments and are offered to users where they apply.
// Const after construction and safe to call from any number of threads.

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "base/vector.h"

namespace barycast {

// Rows of some points, dense over all control vertices.
template <int D>
struct SolvedRows {
  using Table = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Table values;                         // points x control vertices
  std::array<Table, D> gradients;       // the same of every partial derivative, per diagonal; empty unless asked for
  std::vector<uint8_t> on_cage;         // points that lie on the cage but for rounding: their values are the basis
  std::vector<uint8_t> rank_deficient;  // moments that do not span space: what is missing was left out

  void resize(size_t points, size_t control_vertices, bool with_gradients) {
    const auto rows = static_cast<Eigen::Index>(points), columns = static_cast<Eigen::Index>(control_vertices);
    values.setZero(rows, columns);
    for (Table& partial : gradients) partial.setZero(with_gradients ? rows : 0, with_gradients ? columns : 0);
    on_cage.assign(points, 0);
    rank_deficient.assign(points, 0);
  }
};

template <int D>
class Solution {
 public:
  virtual ~Solution() = default;

  // Fills `out` for the points (normalized frame). A point's row depends on that point alone, bit for bit, not on
  // the points asked for with it. Gradients are those of the values as far as each method says. Rows reproduce position
  // as well as the method does: they still want the final correction (estimate/row.h).
  virtual void evaluate(std::span<const Vec<D>> points, bool gradients, SolvedRows<D>& out) const = 0;

  virtual size_t bytes() const = 0;
};

}  // namespace barycast
