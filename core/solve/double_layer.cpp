#include "solve/double_layer.h"

#include <numbers>

namespace barycast {

DoubleLayer::DoubleLayer(const Cage<3>& cage, const Panels& panels, const BoundaryData& data)
    : cage_(cage), data_(data), shares_(3 * panels.panels.size(), 4) {
  for (size_t p = 0; p < panels.panels.size(); ++p) {
    const Panel& panel = panels.panels[p];
    const ElementKind kind = cage.elements()[panel.element].kind;
    element_of_panel_.push_back(panel.element);
    std::array<Eigen::Array4d, 3> corner;
    for (size_t k = 0; k < 3; ++k) {
      std::array<double, 3> barycentric{};
      barycentric[k] = 1.0;
      corner[k] = Eigen::Map<const Eigen::Array4d>(element_shares(kind, panel, barycentric).data());
    }
    // The points lie half way between a corner and the centre.
    for (size_t k = 0; k < 3; ++k)
      shares_.row(static_cast<Eigen::Index>(3 * p + k)) =
          (0.5 * corner[k] + (corner[0] + corner[1] + corner[2]) / 6).transpose();
  }
}

void DoubleLayer::add_basis(uint32_t element, const Eigen::Array4d& shares, Eigen::Ref<BoundaryData::Row> out) const {
  std::vector<VertexWeight> basis;
  cage_.append_basis(cage_.elements()[element], std::span(shares.data(), 4), 1.0, basis);
  for (const VertexWeight& phi : basis) out[data_.column(phi.vertex)] += phi.weight;
}

BoundaryData::Row DoubleLayer::at(size_t panel_point) const {
  BoundaryData::Row row = BoundaryData::Row::Zero(data_.basis_count());
  add_basis(element_of_panel_[panel_point / 3], shares_.row(static_cast<Eigen::Index>(panel_point)).transpose(), row);
  return row;
}

// Panels of an element are consecutive: theirs are summed as shares of its corners first.
void DoubleLayer::add(const PanelKernels::Table& dipoles, Rows& out, Eigen::Array4d& enclosed) const {
  const double factor = -cage_.orientation() / (4 * std::numbers::pi);
  for (size_t first = 0; first < element_of_panel_.size();) {
    const uint32_t element = element_of_panel_[first];
    std::array<Eigen::Array4d, 4> sums;
    sums.fill(Eigen::Array4d::Zero());
    for (; first < element_of_panel_.size() && element_of_panel_[first] == element; ++first)
      for (Eigen::Index k = 0; k < 3; ++k) {
        const Eigen::Index i = static_cast<Eigen::Index>(3 * first) + k;
        const Eigen::Array4d shares = shares_.row(i).transpose();
        for (size_t r = 0; r < 4; ++r) sums[r] += dipoles(static_cast<Eigen::Index>(r), i) * shares;
      }
    for (size_t r = 0; r < 4; ++r) {
      const auto at = static_cast<Eigen::Index>(r);
      enclosed[at] += factor * sums[r].sum();
      add_basis(element, factor * sums[r], out.row(at).head(data_.basis_count()));
    }
  }
}

}  // namespace barycast
