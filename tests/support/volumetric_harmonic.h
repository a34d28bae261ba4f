#pragma once

// Harmonic coordinates on a grid after Joshi et al. [2007], the method that programs ship today: what to compare with,
// not what to trust. Boundary cells hold the basis at the cage's point closest to their centre; interior ones solve the
// 7-point Laplace equation, all control vertices, by conjugate gradients with an incomplete factorization, to a
// residual of 1e-8. Between centres values are trilinear. For closed cages: in others the outside flows in.
//
// The error is first order in the cell: boundary values belong up to half a cell's diagonal away from the centre that
// has them, and nothing restores linear precision. Measured in a box at 16, 32, 64 cells a side: E 0.0104, 0.0047,
// 0.0022; turned against the grid 0.029, 0.015, 0.0072. How faces lie in their cells makes a factor of two: the
// SpikyBox cage at 63, 64, 65 cells 0.0049, 0.0097, 0.0051. Memory: control vertices x kept cells x 8 bytes.

#include <Eigen/IterativeLinearSolvers>
#include <Eigen/SparseCore>
#include <limits>
#include <vector>

#include "base/parallel.h"
#include "support/cell_grid.h"

namespace barycast::testing {

class VolumetricHarmonic {
 public:
  VolumetricHarmonic(const Cage<3>& cage, int resolution) : cage_(cage), grid_(cage, resolution) {
    const auto known = static_cast<Eigen::Index>(grid_.boundary().size());
    values_ = Eigen::MatrixXd::Zero(known + unknowns(), cage_.control_vertex_count());
    std::vector<VertexWeight> basis;
    for (Eigen::Index i = 0; i < known; ++i) {
      const auto& [element, shares] = grid_.boundary()[static_cast<size_t>(i)];
      basis.clear();
      cage_.append_basis(cage_.elements()[element], shares, 1.0, basis);
      for (const VertexWeight& entry : basis) values_(i, entry.vertex) += entry.weight;
    }
    if (unknowns() > 0) solve();
  }

  // Rows of points (n x 3, in the caller's units); not a number in dropped cells, so outside but for the cells that
  // the cage crosses. Where some of the eight centres around a point are dropped, the others share their weight.
  DenseRows evaluate(std::span<const double> points) const {
    const auto count = static_cast<Eigen::Index>(points.size() / 3);
    DenseRows rows = DenseRows::Constant(count, values_.cols(), std::numeric_limits<double>::quiet_NaN());
    for (Eigen::Index i = 0; i < count; ++i)
      look_up(grid_.in_cells(normalized_point(cage_, points, static_cast<size_t>(i))), rows.row(i));
    return rows;
  }

  Eigen::Index unknowns() const { return grid_.interior_count(); }
  // What stays for looking rows up; the solve takes more while it runs.
  size_t bytes() const { return static_cast<size_t>(values_.size()) * sizeof(double) + grid_.bytes(); }

 private:
  using Matrix = Eigen::SparseMatrix<double, Eigen::RowMajor>;
  using Cell = CellGrid::Cell;

  void solve() {
    const Eigen::Index known = values_.rows() - unknowns();
    std::vector<Eigen::Triplet<double>> inner, outer;
    CellGrid::for_each_cell(Cell::Zero(), grid_.size() - Cell::Ones(), [&](const Cell& cell) {
      const Eigen::Index row = grid_.number(cell) - known;
      if (row < 0) return;
      inner.emplace_back(row, row, 6.0);
      // None of them is dropped: the cage lies between.
      CellGrid::for_each_neighbour(cell, [&](const Cell& next) {
        const Eigen::Index column = grid_.number(next);
        if (column >= known) {
          inner.emplace_back(row, column - known, -1.0);
        } else {
          outer.emplace_back(row, column, 1.0);
        }
      });
    });
    Matrix laplacian(unknowns(), unknowns()), from_boundary(unknowns(), known);
    laplacian.setFromTriplets(inner.begin(), inner.end());
    from_boundary.setFromTriplets(outer.begin(), outer.end());
    // A factorization each for about four columns, each of which takes ten times as long.
    parallel_for(static_cast<size_t>(values_.cols()), 4, [&](size_t begin, size_t end) {
      using Factor = Eigen::IncompleteCholesky<double, Eigen::Lower, Eigen::NaturalOrdering<int>>;
      Eigen::ConjugateGradient<Matrix, Eigen::Lower | Eigen::Upper, Factor> solver(laplacian);
      solver.setTolerance(1e-8);
      for (auto column = static_cast<Eigen::Index>(begin); column < static_cast<Eigen::Index>(end); ++column) {
        const Eigen::VectorXd right = from_boundary * values_.col(column).head(known);
        values_.col(column).tail(unknowns()) = solver.solve(right);
      }
    });
  }

  template <class Row>
  void look_up(const Vec<3>& place, Row&& out) const {
    const auto size = grid_.size().cast<double>().array();
    if (!((place.array() >= 0).all() && (place.array() < size).all())) return;  // before the cast: far points
    if (grid_.number(place.array().floor().cast<int>()) < 0) return;
    const Vec<3> corner = place - Vec<3>::Constant(0.5);
    const Cell first = corner.array().floor().cast<int>();
    double sum = 0.0;
    out.setZero();
    CellGrid::for_each_cell(first, first + Cell::Ones(), [&](const Cell& cell) {
      const Eigen::Index number = grid_.number(cell);
      if (number < 0) return;
      const double weight = (Vec<3>::Ones() - (corner - cell.cast<double>()).cwiseAbs()).prod();
      sum += weight;
      out += weight * values_.row(number);
    });
    out /= sum;
  }

  const Cage<3>& cage_;
  CellGrid grid_;
  Eigen::MatrixXd values_;  // kept cells x control vertices, boundary cells first
};

}  // namespace barycast::testing
