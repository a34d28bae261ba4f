#include "solve/double_layer.h"

#include <algorithm>
#include <limits>

namespace barycast {

DoubleLayer::DoubleLayer(const Cage<3>& cage, const Panels& panels, const BoundaryData& data)
    : cage_(cage),
      data_(data),
      first_panel_(cage.elements().size() + 1, static_cast<uint32_t>(panels.panels.size())),
      shares_(3 * panels.panels.size(), 4) {
  for (uint32_t p = static_cast<uint32_t>(panels.panels.size()); p-- > 0;) first_panel_[panels.panels[p].element] = p;
  // Elements without panels begin where the next one does.
  for (size_t e = cage.elements().size(); e-- > 0;) first_panel_[e] = std::min(first_panel_[e], first_panel_[e + 1]);
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

std::vector<BoundaryData::Entry> DoubleLayer::corner_basis(uint32_t element, size_t corner) const {
  const Element& at = cage_.elements()[element];
  std::vector<BoundaryData::Entry> entries;
  if (corner >= static_cast<size_t>(at.corner_count())) return entries;
  std::array<double, 4> shares{};
  shares[corner] = 1.0;
  std::vector<VertexWeight> basis;
  cage_.append_basis(at, shares, 1.0, basis);
  for (const VertexWeight& phi : basis)
    if (phi.weight != 0.0) entries.push_back({data_.column(phi.vertex), phi.weight});
  return entries;
}

// The one that holds the parameters, or misses them by least.
std::optional<size_t> DoubleLayer::panel_at(const Panels& panels, const CagePoint<3>& at) const {
  const auto& s = at.shares;
  const bool quad = cage_.elements()[at.element].kind == ElementKind::kQuad;
  const Vec<2> parameter = quad ? Vec<2>(s[1] + s[2], s[2] + s[3]) : Vec<2>(s[1], s[2]);
  const auto cross = [](const Vec<2>& a, const Vec<2>& b) { return a[0] * b[1] - a[1] * b[0]; };
  std::optional<size_t> best;
  double best_inside = -std::numeric_limits<double>::infinity();
  for (uint32_t p = first_panel_[at.element]; p < first_panel_[at.element + 1]; ++p) {
    const auto& t = panels.panels[p].parameter;
    double inside = std::numeric_limits<double>::infinity();
    for (size_t k = 0; k < 3; ++k)
      inside = std::min(inside, cross(t[(k + 1) % 3] - t[k], parameter - t[k]) / cross(t[1] - t[0], t[2] - t[0]));
    if (inside <= best_inside) continue;
    best_inside = inside;
    best = p;
  }
  return best;
}

// Panels of an element are consecutive: theirs are summed as shares of its corners first.
void DoubleLayer::add(const PanelKernels::Table& dipoles, Rows& out, Eigen::Array4d& enclosed) const {
  const double scale = factor();
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
      enclosed[at] += scale * sums[r].sum();
      add_basis(element, scale * sums[r], out.row(at).head(data_.basis_count()));
    }
  }
}

}  // namespace barycast
