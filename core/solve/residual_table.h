#pragma once

// What a prediction misses on the cage, as a function there: known at the nodes of a lattice on every element, bilinear
// in between. The prediction's own error is all that is interpolated, not the coordinates. It is steep next to the
// edges of elements: there the lattice is finer. Cells where it bends all the same, as where elements cut each other,
// are rough: there it is for the caller to evaluate.

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "cage/cage.h"

namespace barycast {

class ResidualTable {
 public:
  // As many nodes on every element as leave about `nodes` in all; within bounds.
  ResidualTable(const Cage<3>& cage, size_t columns, size_t nodes);

  size_t node_count() const { return cage_.elements().size() * nodes_of_element(); }

  // A node's place. Those on the border of their element are a little inside of it: there a function on one side of the
  // cage is as smooth as on the rest of the element.
  struct Node {
    uint32_t element;
    std::array<double, 4> shares;
  };
  Node node(size_t i) const;
  // The nearest place of an element that is as far inside of it as nodes are.
  Node inset(uint32_t element, const std::array<double, 4>& shares) const;
  std::span<float> row(size_t i) { return std::span(rows_).subspan(i * columns_, columns_); }

  // After all rows were set: finds the cells where straight lines between nodes are off by more than the tolerance of
  // their element in any column, judged by how the slopes change from cell to cell.
  void find_rough(std::span<const double> tolerance);
  bool has_rough() const { return !rough_.empty(); }
  bool is_rough(uint32_t element, const std::array<double, 4>& shares) const;

  // Adds weight times the function's value at a point of the cage to the first sum.size() columns.
  void add(uint32_t element, const std::array<double, 4>& shares, double weight, std::span<double> sum) const;

  // Nodes of a table for so many elements.
  static size_t node_count(size_t elements, size_t nodes);
  size_t bytes() const {
    return rows_.capacity() * sizeof(float) + position_.capacity() * sizeof(double) + rough_.capacity();
  }

 private:
  struct Cell {
    size_t first;  // node
    double part;   // of the way to the next
  };
  Cell cell(double t) const;
  std::array<double, 2> parameters(uint32_t element, const std::array<double, 4>& shares) const;
  // Along both parameters.
  std::array<Cell, 2> cells(uint32_t element, const std::array<double, 4>& shares) const;
  size_t steps() const { return position_.size() - 1; }
  void find_rough(uint32_t element, double tolerance, std::span<uint8_t> rough) const;
  size_t nodes_of_element() const { return position_.size() * position_.size(); }
  bool is_quad(uint32_t element) const { return cage_.elements()[element].kind == ElementKind::kQuad; }

  const Cage<3>& cage_;
  size_t columns_;
  std::vector<double> position_;  // of nodes along either parameter of an element, from 0 to 1
  std::vector<float> rows_;
  std::vector<uint8_t> rough_;  // by element and cell; empty where none is
};

}  // namespace barycast
