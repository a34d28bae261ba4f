#pragma once

// Potentials of all panels at a point at once: what densities, given by their values at the panels' points, are
// multiplied by to be a potential there. Exact near a panel; far panels are seven points or three.

#include "solve/panels.h"

namespace barycast {

class PanelKernels {
 public:
  explicit PanelKernels(Panels panels);

  const Panels& panels() const { return panels_; }
  Eigen::Index point_count() const { return charge_.size(); }  // three a panel

  // A column per point of the panels. Rows: potentials at four places, or one potential and its gradient.
  using Table = Eigen::Matrix<double, 4, Eigen::Dynamic, Eigen::RowMajor>;
  struct Tables {
    Table charges, dipoles;  // see panel_potential.h; dipoles along the panels' normals
    explicit Tables(Eigen::Index point_count)
        : charges(Table::Zero(4, point_count)), dipoles(Table::Zero(4, point_count)) {}
  };

  // What a point x makes of every panel, in row `row`; with the gradient, in row 0 and in those after it. Those of
  // dipoles are left alone unless asked for.
  void fill(const Vec<3>& x, Eigen::Index row, bool gradient, bool dipoles, Tables& out) const;

  size_t bytes() const;

 private:
  Panels panels_;
  Eigen::Array<double, Eigen::Dynamic, 3> points_, normals_;  // of the panels
  Eigen::ArrayXd charge_;                                     // a third of the panel's area
};

}  // namespace barycast
