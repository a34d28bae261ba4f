#include "solve/boundary_field.h"

#include <algorithm>
#include <cmath>

#include "base/tolerances.h"
#include "query/element_distance.h"
#include "solve/closed.h"
#include "solve/moment_field.h"
#include "solve/panel_potential.h"

namespace barycast {
namespace {

// Distances, in radii of a panel, from which seven points and three points stand for it.
constexpr double kSevenPointRadii = 5.0;
constexpr double kThreePointRadii = 12.0;
// The potential's error on the cage alternates from panel to panel and fades off it within a part of their size. A
// fifth is best: on a box and on FireHydrant less leaves more of it, twice as much brings it to points without.
constexpr double kBlendPanels = 0.2;
// 1 on the cage, 0 from `width` on, with the derivative.
struct Fade {
  double weight = 0.0, rate = 0.0;
  Fade(double distance, double width) {
    if (distance >= width) return;
    const double s = distance / width;
    weight = 1 - s * s * (3 - 2 * s);
    rate = -6 * s * (1 - s) / width;
  }
};

}  // namespace

// A query with what the cage says about it.
struct BoundaryField::Query {
  Vec<3> x;            // where potentials are evaluated
  CagePoint<3> y;      // closest point
  double blend_width;  // 0: too far from the cage
  bool on_cage;
  bool project;  // moments are needed
};

BoundaryField::BoundaryField(const Cage<3>& cage, const DistanceIndex<3>& distance, const WindingNumber<3>& winding,
                             Panels panels, const BoundaryData& data, DensityGroups densities)
    : cage_(cage),
      distance_(distance),
      winding_(winding),
      panels_(std::move(panels)),
      data_(data),
      is_closed_(is_closed(cage)),
      points_(3 * panels_.panels.size(), 3),
      charge_(3 * panels_.panels.size()),
      densities_(std::move(densities)) {
  for (size_t p = 0; p < panels_.panels.size(); ++p)
    for (size_t k = 0; k < 3; ++k) {
      points_.row(static_cast<Eigen::Index>(3 * p + k)) = panels_.panels[p].point[k].transpose().array();
      charge_[static_cast<Eigen::Index>(3 * p + k)] = panels_.panels[p].area / 3;
    }
}

size_t BoundaryField::bytes() const {
  return sizeof(*this) + panels_.panels.size() * sizeof(Panel) +
         static_cast<size_t>(charge_.size()) * (4 + densities_.size() * kDensityGroup) * sizeof(double);
}

// Far panels as three point charges, all at once; then what is nearer, panel by panel.
void BoundaryField::fill_kernels(const Vec<3>& x, Eigen::Index row, bool gradient, Kernels& kernels) const {
  const Eigen::ArrayXd dx = points_.col(0) - x[0], dy = points_.col(1) - x[1], dz = points_.col(2) - x[2];
  const Eigen::ArrayXd inverse_squared = (dx.square() + dy.square() + dz.square()).inverse();
  const Eigen::ArrayXd value = charge_ * inverse_squared.sqrt();
  kernels.row(row) = value.matrix().transpose();
  if (gradient) {
    const Eigen::ArrayXd rate = value * inverse_squared;
    kernels.row(1) = (rate * dx).matrix().transpose();
    kernels.row(2) = (rate * dy).matrix().transpose();
    kernels.row(3) = (rate * dz).matrix().transpose();
  }
  PanelPotential potential;
  for (size_t p = 0; p < panels_.panels.size(); ++p) {
    const Panel& panel = panels_.panels[p];
    const double distance_squared = (panel.centre - x).squaredNorm(), radius_squared = panel.radius * panel.radius;
    if (distance_squared > kThreePointRadii * kThreePointRadii * radius_squared) continue;
    if (distance_squared > kSevenPointRadii * kSevenPointRadii * radius_squared) {
      far_potential(panel, x, gradient, potential);
    } else {
      exact_potential(panel, x, gradient, potential);
    }
    const auto at = static_cast<Eigen::Index>(3 * p);
    kernels.block<1, 3>(row, at) = potential.value.transpose();
    if (gradient)
      for (Eigen::Index k = 0; k < 3; ++k)
        for (Eigen::Index i = 0; i < 3; ++i) kernels(1 + i, at + k) = potential.gradient[static_cast<size_t>(k)][i];
  }
}

// Every sum runs over the panels in their order, whatever the other rows and columns are.
void BoundaryField::multiply(const Kernels& kernels, Eigen::Index columns, Potentials& out) const {
  out.resize(4, columns);
  const Eigen::Index panel_points = charge_.size();
  for (Eigen::Index first = 0; first < columns;) {
    const DensityColumn at(first, data_);
    using Lanes = Eigen::Array<double, kLanes, 1>;
    Lanes sums[4] = {Lanes::Zero(), Lanes::Zero(), Lanes::Zero(), Lanes::Zero()};
    const double* density = densities_[at.group].data() + at.lane;
    for (Eigen::Index i = 0; i < panel_points; ++i, density += kDensityGroup) {
      const Eigen::Map<const Lanes> lanes(density);
      for (Eigen::Index r = 0; r < 4; ++r) sums[r] += kernels(r, i) * lanes;
    }
    // The basis' last lanes may be empty.
    const Eigen::Index end = first < data_.basis_count() ? data_.basis_count() : data_.count();
    const Eigen::Index used = std::min(kLanes, end - first);
    for (Eigen::Index r = 0; r < 4; ++r) out.row(r).segment(first, used) = sums[r].head(used).matrix().transpose();
    first += used;
  }
}

void BoundaryField::set_row(const BoundaryData::Row& values, SolvedRows<3>::Table& table, Eigen::Index row) const {
  Eigen::Index column = 0;
  for (const uint32_t v : cage_.used_vertices()) table(row, v) = values[column++];
}

// A place near a point of the cage, inside where there is one. At edges the densities of the two faces differ and
// gradients are infinite: there it is taken as far off as the correction near the cage reaches.
Vec<3> BoundaryField::just_inside(const CagePoint<3>& y, double blend_width) const {
  const Element& element = cage_.elements()[y.element];
  const auto corners = static_cast<size_t>(element.corner_count());
  const Vec<3> inward = -cage_.orientation() * element_normal(cage_, element, y.shares);
  Vec<3> centre = Vec<3>::Zero();
  for (size_t i = 0; i < corners; ++i)
    centre += cage_.corner(element, static_cast<int>(i)) / static_cast<double>(corners);
  const Vec<3> along = (centre - y.point).normalized();
  const bool on_edge =
      std::count_if(y.shares.begin(), y.shares.begin() + corners, [](double s) { return s < 1e-9; }) > 0;
  const double shift = on_edge ? blend_width : kExactGradientShift;
  // Away from an edge and from both of its faces; at an acute one, closer to this face; and faces may face either way.
  const double tilt = on_edge ? 1.0 : 0.0;
  for (const double rise : {1.0, 0.1, -1.0, -0.1}) {
    const Vec<3> place = y.point + shift * (tilt * along + rise * inward).normalized();
    if (winding_.inside(place)) return place;
  }
  return y.point + shift * inward;
}

BoundaryField::Query BoundaryField::prepare(const Vec<3>& x) const {
  Query query;
  query.x = x;
  query.y = distance_.closest(x);
  const Element& element = cage_.elements()[query.y.element];
  double width = 0.0;
  for (size_t i = 0; i < static_cast<size_t>(element.corner_count()); ++i)
    width += kBlendPanels * query.y.shares[i] * panels_.node_size[element.node[i]];
  query.blend_width = query.y.distance < width ? width : 0.0;
  query.on_cage = query.y.distance < kExactOnCage;
  if (query.on_cage) query.x = just_inside(query.y, width);
  query.project = data_.has_moments() && (!is_closed_ || !winding_.inside(query.x));
  return query;
}

void BoundaryField::evaluate_with_gradient(const Query& query, Eigen::Index row, SolvedRows<3>& out) const {
  const Eigen::Index n = data_.basis_count(), columns = query.project ? data_.count() : n;
  Kernels kernels(4, charge_.size());
  Potentials at_x, at_y;
  fill_kernels(query.x, 0, true, kernels);
  multiply(kernels, columns, at_x);
  BoundaryData::Row values = at_x.row(0);
  std::array<BoundaryData::Row, 3> slopes = {at_x.row(1), at_x.row(2), at_x.row(3)};
  if (query.blend_width > (query.x - query.y.point).norm()) {
    fill_kernels(query.y.point, 0, true, kernels);
    multiply(kernels, columns, at_y);
    BoundaryData::Row wanted(columns);
    data_.values(query.y.element, query.y.shares, query.y.point, wanted);
    std::array<BoundaryData::Row, 3> wanted_slopes;
    Mat<3> tangent;
    data_.gradients(query.y, wanted_slopes, tangent);
    const Vec<3> away = query.x - query.y.point;
    const double distance = away.norm();
    const Fade fade(distance, query.blend_width);
    const BoundaryData::Row missing = wanted - at_y.row(0);
    values += fade.weight * missing;
    for (Eigen::Index k = 0; k < 3; ++k) {
      BoundaryData::Row along = wanted_slopes[static_cast<size_t>(k)].head(columns);
      for (Eigen::Index a = 0; a < 3; ++a) along -= tangent(k, a) * at_y.row(1 + a);
      slopes[static_cast<size_t>(k)] += fade.weight * along + (fade.rate * away[k] / distance) * missing;
    }
  }
  if (query.project) {
    BoundaryData::Row projected(n);
    std::array<BoundaryData::Row, 3> gradients;
    if (!project_moments(query.x, values, slopes, n, projected, gradients))
      out.rank_deficient[static_cast<size_t>(row)] = 1;
    values = projected;
    slopes = gradients;
  }
  set_row(values, out.values, row);
  for (size_t k = 0; k < 3; ++k) set_row(slopes[k], out.gradients[k], row);
}

void BoundaryField::evaluate_values(std::span<const Query> queries, Eigen::Index first_row, SolvedRows<3>& out) const {
  const Eigen::Index n = data_.basis_count();
  Eigen::Index columns = n;
  Kernels kernels = Kernels::Zero(4, charge_.size());
  Potentials at_x, at_y;
  for (size_t i = 0; i < queries.size(); ++i) {
    fill_kernels(queries[i].x, static_cast<Eigen::Index>(i), false, kernels);
    if (queries[i].project) columns = data_.count();
  }
  multiply(kernels, columns, at_x);
  if (std::any_of(queries.begin(), queries.end(), [](const Query& query) { return query.blend_width > 0.0; })) {
    for (size_t i = 0; i < queries.size(); ++i)
      if (queries[i].blend_width > 0.0) fill_kernels(queries[i].y.point, static_cast<Eigen::Index>(i), false, kernels);
    multiply(kernels, columns, at_y);
  }
  for (size_t i = 0; i < queries.size(); ++i) {
    const Query& query = queries[i];
    BoundaryData::Row values = at_x.row(static_cast<Eigen::Index>(i));
    if (query.blend_width > 0.0) {
      BoundaryData::Row wanted(columns);
      data_.values(query.y.element, query.y.shares, query.y.point, wanted);
      const Fade fade(query.y.distance, query.blend_width);
      values += fade.weight * (wanted - at_y.row(static_cast<Eigen::Index>(i)));
    }
    const Eigen::Index row = first_row + static_cast<Eigen::Index>(i);
    if (query.project) {
      BoundaryData::Row projected(n);
      std::array<BoundaryData::Row, 3> no_gradients;
      if (!project_moments(query.x, values, {}, n, projected, no_gradients))
        out.rank_deficient[static_cast<size_t>(row)] = 1;
      set_row(projected, out.values, row);
    } else {
      set_row(values, out.values, row);
    }
  }
}

void BoundaryField::evaluate(std::span<const Vec<3>> points, bool gradients, SolvedRows<3>& out) const {
  out.resize(points.size(), cage_.control_vertex_count(), gradients);
  std::vector<Query> queries;
  for (const Vec<3>& x : points) queries.push_back(prepare(x));
  if (gradients) {
    for (size_t i = 0; i < queries.size(); ++i) evaluate_with_gradient(queries[i], static_cast<Eigen::Index>(i), out);
  } else {
    for (size_t i = 0; i < queries.size(); i += 4)
      evaluate_values(std::span(queries).subspan(i, std::min<size_t>(4, queries.size() - i)),
                      static_cast<Eigen::Index>(i), out);
  }
  for (size_t i = 0; i < queries.size(); ++i) {
    if (!queries[i].on_cage) continue;
    out.on_cage[i] = 1;
    BoundaryData::Row basis(data_.basis_count());
    data_.values(queries[i].y.element, queries[i].y.shares, queries[i].y.point, basis);
    set_row(basis, out.values, static_cast<Eigen::Index>(i));
  }
}

}  // namespace barycast
