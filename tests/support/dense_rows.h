#pragma once

// What the reference instruments have in common: rows as a dense matrix, and values at the nodes of a cage handed
// on to its control vertices.

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <span>

#include "cage/cage.h"

namespace barycast::testing {

// Points x control vertices.
using DenseRows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Point i of `points` (n x D, row-major, in the caller's units), normalized.
template <int D>
Vec<D> normalized_point(const Cage<D>& cage, std::span<const double> points, size_t i) {
  return cage.frame().to_normalized(Eigen::Map<const Vec<D>>(points.data() + i * D));
}

// Nodes that elements refer to: control vertices and polygon centres.
template <int D>
uint32_t node_count(const Cage<D>& cage) {
  uint32_t count = cage.control_vertex_count();
  for (const Element& element : cage.elements())
    for (int i = 0; i < element.corner_count(); ++i) count = std::max(count, element.node[static_cast<size_t>(i)] + 1);
  return count;
}

// A value at a node goes to the control vertices behind it.
template <int D, class Row>
void add_node_value(const Cage<D>& cage, uint32_t node, double value, Row&& row) {
  for (const VertexWeight& entry : cage.stencil(node)) row[entry.vertex] += entry.weight * value;
}

// E of the rows that are finite: the root mean square over rows of the distance between them.
inline double row_error(const DenseRows& a, const DenseRows& b) {
  double squared = 0.0;
  Eigen::Index count = 0;
  for (Eigen::Index i = 0; i < a.rows(); ++i) {
    const double distance = (a.row(i) - b.row(i)).squaredNorm();
    if (!std::isfinite(distance)) continue;
    squared += distance;
    ++count;
  }
  return std::sqrt(squared / static_cast<double>(count));
}

}  // namespace barycast::testing
