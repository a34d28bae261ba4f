#pragma once

// A grid of cubic cells over a cage, as volumetric methods lay it [Joshi et al. 2007]: cells that the cage crosses
// (boundary), cells that can be reached from outside without crossing it (dropped), and the others (interior). Boundary
// cells remember the cage's point closest to their centre. Elements are cut into facets of a cell's size for that, a
// second-order error on bilinear patches.

#include <vector>

#include "support/dense_rows.h"
#include "support/facets.h"

namespace barycast::testing {

class CellGrid {
 public:
  using Cell = Eigen::Vector3i;
  struct CagePlace {
    uint32_t element;
    std::array<double, 4> shares;
  };
  static constexpr Eigen::Index kDropped = -2;

  // `resolution` cells along the longest side of the cage's box and its margin.
  CellGrid(const Cage<3>& cage, int resolution) {
    lay(cage, resolution);
    mark_boundary(cage);
    drop_exterior();
  }

  const Cell& size() const { return size_; }
  // Of every cell: kDropped, or its number, boundary cells first. Cells off the grid are dropped.
  Eigen::Index number(const Cell& cell) const { return contains(cell) ? numbers_[index(cell)] : kDropped; }
  const std::vector<CagePlace>& boundary() const { return boundary_; }
  Eigen::Index interior_count() const { return interior_count_; }
  size_t bytes() const { return numbers_.size() * sizeof(Eigen::Index) + boundary_.size() * sizeof(CagePlace); }

  // A normalized point in cells, from the grid's lowest corner; centres are at halves.
  Vec<3> in_cells(const Vec<3>& x) const { return (x - origin_) / edge_; }

  template <class Body>
  static void for_each_cell(const Cell& first, const Cell& last, const Body& body) {
    for (Cell cell = first; cell[2] <= last[2]; ++cell[2])
      for (cell[1] = first[1]; cell[1] <= last[1]; ++cell[1])
        for (cell[0] = first[0]; cell[0] <= last[0]; ++cell[0]) body(cell);
  }
  template <class Body>
  static void for_each_neighbour(const Cell& cell, const Body& body) {
    for (int k = 0; k < 6; ++k) body(Cell(cell + (k % 2 == 0 ? 1 : -1) * Cell::Unit(k / 2)));
  }

 private:
  static constexpr Eigen::Index kUnseen = -1;

  // Offsets of a quarter cell: neither are the faces of an aligned box at centres, where a grid is exact, nor between
  // cells, where two layers would hold them.
  void lay(const Cage<3>& cage, int resolution) {
    Vec<3> low = Vec<3>::Constant(1), high = -low;
    for (const uint32_t v : cage.used_vertices()) {
      low = low.cwiseMin(cage.control_vertices()[v]);
      high = high.cwiseMax(cage.control_vertices()[v]);
    }
    edge_ = (high - low).maxCoeff() / (resolution - 2.5);
    origin_ = low - Vec<3>::Constant(1.25 * edge_);
    size_ = ((high - low) / edge_ + Vec<3>::Constant(2.5 - 1e-9)).array().ceil().cast<int>();
    numbers_.assign(static_cast<size_t>(size_.prod()), kUnseen);
  }

  size_t index(const Cell& cell) const {
    return static_cast<size_t>((cell[2] * size_[1] + cell[1]) * size_[0] + cell[0]);
  }
  bool contains(const Cell& cell) const { return (cell.array() >= 0).all() && (cell.array() < size_.array()).all(); }

  // Every cell that a facet touches gets the closest point of the facets that touch it.
  void mark_boundary(const Cage<3>& cage) {
    std::vector<double> nearest;
    for (const Facet& facet : facets_of(cage, edge_)) {
      const Vec<3>&a = facet.corner[0], &b = facet.corner[1], &c = facet.corner[2];
      const Vec<3> low = in_cells(a.cwiseMin(b).cwiseMin(c)), high = in_cells(a.cwiseMax(b).cwiseMax(c));
      const auto mark = [&](const Cell& cell) {
        const Vec<3> centre = origin_ + edge_ * (cell.cast<double>() + Vec<3>::Constant(0.5));
        if (!touches_cube(facet.corner, centre, edge_ / 2)) return;
        const Vec<3> shares = closest_shares(facet.corner, centre);
        const double distance = (shares[0] * a + shares[1] * b + shares[2] * c - centre).squaredNorm();
        Eigen::Index& number = numbers_[index(cell)];
        if (number == kUnseen) {
          number = static_cast<Eigen::Index>(nearest.size());
          nearest.push_back(distance);
          boundary_.emplace_back();
        } else if (distance >= nearest[static_cast<size_t>(number)]) {
          return;
        }
        const Eigen::Vector2d place =
            shares[0] * facet.place[0] + shares[1] * facet.place[1] + shares[2] * facet.place[2];
        nearest[static_cast<size_t>(number)] = distance;
        boundary_[static_cast<size_t>(number)] = {facet.element, shares_at(cage.elements()[facet.element], place)};
      };
      for_each_cell((low.array() - 1e-9).floor().cast<int>(), (high.array() + 1e-9).floor().cast<int>(), mark);
    }
  }

  // From the outermost cells on; then what is left is numbered.
  void drop_exterior() {
    std::vector<Cell> reached;
    const auto reach = [&](const Cell& cell) {
      if (number(cell) != kUnseen) return;
      numbers_[index(cell)] = kDropped;
      reached.push_back(cell);
    };
    const Cell last = size_ - Cell::Ones();
    for_each_cell(Cell::Zero(), last, [&](const Cell& cell) {
      if ((cell.array() == 0).any() || (cell.array() == last.array()).any()) reach(cell);
    });
    while (!reached.empty()) {
      const Cell cell = reached.back();
      reached.pop_back();
      for_each_neighbour(cell, reach);
    }
    const auto known = static_cast<Eigen::Index>(boundary_.size());
    for (Eigen::Index& number : numbers_)
      if (number == kUnseen) number = known + interior_count_++;
  }

  double edge_ = 0.0;  // of a cell
  Vec<3> origin_;      // the grid's lowest corner
  Cell size_;
  std::vector<Eigen::Index> numbers_;
  std::vector<CagePlace> boundary_;
  Eigen::Index interior_count_ = 0;
};

}  // namespace barycast::testing
