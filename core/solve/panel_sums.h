#pragma once

// The sums that boundary elements are evaluated by, fast: of all columns at many points, in floats. The same as
// PanelKernels::fill and a product with the densities, and DoubleLayer::add where there are dipoles; without what
// BoundaryField does near the cage and outside of it.
//
// Far panels are three points, nearer ones seven, and near ones exact, in floats or, next to the panel, in doubles.
// Values are within 1e-5 of those in doubles: what is left is rounding in floats at two to four radii, some millionths
// of a panel's radius times its density (1.5e-5 where densities are four on 250 panels, as of FireHydrant's cage
// without dipoles). Gradients are within a thousandth of their RMS over the cage; nearer to an edge of a panel than a
// thousandth of its size they lose digits with the distance, and on it they are large but finite. Points within 1e-13
// diagonals of a panel's plane are on it: there the dipoles' potential is the mean of both sides.
//
// Cost, on a core with AVX-512 (AVX2), 250 panels and 48 columns: 2.2 us (2.9) a point, with gradients 6.4 us (7.6);
// 500 panels: 3.8 us (4.7) and 12 us (14.5). A third of it is the product with the densities, at the rate of the
// processor.
//
// Const and safe to call from any number of threads. A point's row has the same bits whatever points are asked for
// with it, with gradients and without, and on every processor.

#include <array>
#include <memory>
#include <span>
#include <vector>

#include "solve/boundary_data.h"
#include "solve/density_groups.h"
#include "solve/double_layer.h"
#include "solve/panel_sums_lanes.h"
#include "solve/panels.h"

namespace barycast {

class PanelSums {
 public:
  // Copies what it needs. With dipoles, -D[phi_v] is added to the columns of the basis. `densities`: of all columns of
  // `data` or those of the basis alone.
  PanelSums(const Panels& panels, const BoundaryData& data, const DensityGroups& densities, const DoubleLayer* dipoles);

  Eigen::Index column_count() const { return column_count_; }

  struct Rows {
    using Table = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    Table values;                    // points x columns
    std::array<Table, 3> gradients;  // of every partial derivative, per diagonal; empty unless asked for
    std::vector<float> enclosed;     // -D[1]: 1 inside the panels, 0 outside, 1/2 on them; empty without dipoles
  };

  // Replaces what `out` held by the first `columns` columns of every point (normalized frame). Points next to each
  // other in space should be next to each other in the list: they share vectors. In random order: 1.5 times the cost.
  void evaluate(std::span<const Vec<3>> points, Eigen::Index columns, bool gradients, Rows& out) const;

  // Some of the panels, in ascending order, and what others add up to.
  struct Part {
    std::span<const uint32_t> panels;
    const SumExpansion* others = nullptr;
  };
  std::span<const uint32_t> all_panels() const { return all_panels_; }
  // Of a column on a panel, in magnitude.
  double charge(size_t panel, size_t column) const;

  // Fills rows of a table, of as many points at a time as a batch has, each batch by a part of its own. For one thread;
  // `sums` and `out` must outlive it.
  class Evaluator {
   public:
    Evaluator(const PanelSums& sums, size_t points, Eigen::Index columns, bool gradients, Rows& out);
    ~Evaluator();
    // `rows` of `out` are those of the points, at most kSumPoints.
    void fill(const Part& part, std::span<const Vec<3>> points, std::span<const size_t> rows);

   private:
    struct Workspace;
    const PanelSums& sums_;
    Rows& out_;
    bool gradients_;
    std::unique_ptr<Workspace> work_;
  };

  size_t bytes() const;
  // About the same for so many panels, with dipoles; and what a thread needs while it evaluates `points`.
  static size_t bytes(size_t panels, size_t columns);
  static size_t evaluation_bytes(size_t points, size_t columns, size_t basis, bool gradients);

 private:
  void add_dipoles(const DoubleLayer& dipoles, const Panels& panels);
  SumTables tables() const;

  Eigen::Index column_count_, basis_count_;
  std::vector<SumLine> densities_;  // by point of a panel, columns rounded up to whole lines
  std::vector<SumPoints> points_;
  std::vector<SumTriangle<float>> triangles_;
  std::vector<SumTriangle<double>> exact_triangles_;
  std::vector<std::array<std::array<float, 4>, 3>> shares_;
  std::vector<SumElement> elements_;
  std::vector<SumEntry> entries_;
  std::vector<uint32_t> all_panels_;
};

}  // namespace barycast
