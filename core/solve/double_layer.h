#pragma once

// The part of Green's representation formula that is known beforehand: inside a closed cage a harmonic function is
// u = S[du/dn] - D[u], its values on the cage as dipoles. Here D of the basis functions phi_v, as linear functions
// on the panels that agree at their corners.

#include <numbers>
#include <optional>
#include <vector>

#include "solve/boundary_data.h"
#include "solve/panel_kernels.h"

namespace barycast {

class DoubleLayer {
 public:
  DoubleLayer(const Cage<3>& cage, const Panels& panels, const BoundaryData& data);

  using Rows = Eigen::Matrix<double, 4, Eigen::Dynamic, Eigen::RowMajor>;
  // Adds -D[phi_v] to the first columns of `out`, from rows of PanelKernels, and -D[1] to `enclosed`: the latter is 1
  // inside the panels, 0 outside, 1/2 on them. Every row depends on the same row alone.
  void add(const PanelKernels::Table& dipoles, Rows& out, Eigen::Array4d& enclosed) const;

  // phi_v at a point of a panel, as the dipoles have it: a row of the columns of the basis.
  BoundaryData::Row at(size_t panel_point) const;

  // What `add` does, for those who sum in another order: with each dipole times `factor`, shares of the corners of the
  // panel's element, at a point of a panel; and phi_v at such a corner, a column may occur more than once.
  double factor() const { return -cage_.orientation() / (4 * std::numbers::pi); }
  Eigen::Array4d shares(size_t panel_point) const { return shares_.row(static_cast<Eigen::Index>(panel_point)); }
  std::vector<BoundaryData::Entry> corner_basis(uint32_t element, size_t corner) const;

  // The panel that a point of the cage lies on, or over; none where its element has none.
  std::optional<size_t> panel_at(const Panels& panels, const CagePoint<3>& at) const;

  size_t bytes() const { return static_cast<size_t>(shares_.size()) * sizeof(double); }

 private:
  void add_basis(uint32_t element, const Eigen::Array4d& shares, Eigen::Ref<BoundaryData::Row> out) const;

  const Cage<3>& cage_;
  BoundaryData data_;
  std::vector<uint32_t> element_of_panel_, first_panel_;             // the latter by element, and one beyond
  Eigen::Array<double, Eigen::Dynamic, 4, Eigen::RowMajor> shares_;  // of the element's corners, per point of a panel
};

}  // namespace barycast
