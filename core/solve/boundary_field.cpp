#include "solve/boundary_field.h"

#include <algorithm>
#include <cmath>

#include "base/tolerances.h"
#include "query/element_distance.h"
#include "solve/closed.h"
#include "solve/moment_field.h"
#include "solve/panel_jump.h"

namespace barycast {
namespace {

// The potential's error on the cage alternates from panel to panel and fades off it within a part of their size. A
// fifth is best: on a box and on FireHydrant less leaves more of it, twice as much brings it to points without.
constexpr double kBlendPanels = 0.2;
// What is missing on the cage is taken this close to it, on the query's side: dipoles jump across panels.
constexpr double kBesideCage = 1e-9;
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
  size_t row;          // of the answer
  Vec<3> x;            // where potentials are evaluated
  CagePoint<3> y;      // closest point
  Vec<3> beside;       // it, as seen from x
  double blend_width;  // 0: too far from the cage
  bool on_cage;
  bool inside;   // with dipoles
  bool project;  // moments are needed
};

BoundaryField::BoundaryField(const Cage<3>& cage, const DistanceIndex<3>& distance, const WindingNumber<3>& winding,
                             BoundaryParts parts)
    : cage_(cage),
      distance_(distance),
      winding_(winding),
      kernels_(std::move(parts.kernels)),
      dipoles_(std::move(parts.dipoles)),
      data_(parts.data),
      is_closed_(is_closed(cage)),
      densities_(std::move(parts.densities)) {}

size_t BoundaryField::bytes() const {
  const size_t groups = densities_.indirect.size() + densities_.inside.size();
  return sizeof(*this) + kernels_.bytes() + dipoles_.bytes() +
         static_cast<size_t>(kernels_.point_count()) * groups * kDensityGroup * sizeof(double);
}

// Every sum runs over the panels in their order, whatever the other rows and columns are.
void BoundaryField::multiply(const PanelKernels::Tables& kernels, bool inside, Eigen::Index columns,
                             Potentials& out) const {
  const DensityGroups& densities = inside ? densities_.inside : densities_.indirect;
  out.columns.resize(4, columns);
  out.enclosed.setZero();
  for (Eigen::Index first = 0; first < columns;) {
    const DensityColumn at(first, data_);
    using Lanes = Eigen::Array<double, kLanes, 1>;
    Lanes sums[4] = {Lanes::Zero(), Lanes::Zero(), Lanes::Zero(), Lanes::Zero()};
    const double* density = densities[at.group].data() + at.lane;
    for (Eigen::Index i = 0; i < kernels_.point_count(); ++i, density += kDensityGroup) {
      const Eigen::Map<const Lanes> lanes(density);
      for (Eigen::Index r = 0; r < 4; ++r) sums[r] += kernels.charges(r, i) * lanes;
    }
    // The basis' last lanes may be empty.
    const Eigen::Index end = first < data_.basis_count() ? data_.basis_count() : data_.count();
    const Eigen::Index used = std::min(kLanes, end - first);
    for (Eigen::Index r = 0; r < 4; ++r)
      out.columns.row(r).segment(first, used) = sums[r].head(used).matrix().transpose();
    first += used;
  }
  if (inside) dipoles_.add(kernels.dipoles, out.columns, out.enclosed);
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
  // A patch may bulge out of the facets that the winding number knows by more than that.
  if (!on_edge && !densities_.inside.empty()) return y.point + shift * inward;
  // Away from an edge and from both of its faces; at an acute one, closer to this face; in a thin place, less far; and
  // faces may face either way.
  const double tilt = on_edge ? 1.0 : 0.0;
  for (double part = shift; part >= kExactGradientShift; part *= 0.1)
    for (const double rise : {1.0, 0.1, 0.01, -1.0, -0.1, -0.01}) {
      const Vec<3> place = y.point + part * (tilt * along + rise * inward).normalized();
      if (winding_.inside(place)) return place;
    }
  return y.point + shift * inward;
}

BoundaryField::Query BoundaryField::prepare(const Vec<3>& x, size_t row) const {
  Query query;
  query.row = row;
  query.x = x;
  query.y = distance_.closest(x);
  const Element& element = cage_.elements()[query.y.element];
  double width = 0.0;
  for (size_t i = 0; i < static_cast<size_t>(element.corner_count()); ++i)
    width += kBlendPanels * query.y.shares[i] * kernels_.panels().node_size[element.node[i]];
  query.blend_width = query.y.distance < width ? width : 0.0;
  query.on_cage = query.y.distance < kExactOnCage;
  if (query.on_cage) query.x = just_inside(query.y, width);
  const Vec<3> away = query.x - query.y.point;
  query.beside = query.y.point + std::min(1.0, kBesideCage / away.norm()) * away;
  // On the cage gradients are those of inside; and where all points are, there is nothing else to ask.
  const bool by_place = densities_.indirect.empty() || (query.on_cage && !densities_.inside.empty());
  const bool enclosed = by_place || (is_closed_ && winding_.inside(query.x));
  query.inside = enclosed && !densities_.inside.empty();
  query.project = data_.has_moments() && !enclosed;
  return query;
}

Eigen::Index BoundaryField::columns_of(const Query& query) const {
  return query.project ? data_.count() : data_.basis_count();
}

// Between a patch and the panels that were cut from it a point may be inside of the one and outside of the others:
// there the potentials are those of inside, continued. `row` of `out` holds the potentials at x, with the gradient in
// the rows after it.
void BoundaryField::continue_beyond_panels(const Query& query, const Vec<3>& x, Eigen::Index row, bool gradient,
                                           Potentials& out) const {
  if (!query.inside) return;
  const double outside = outside_part(out.enclosed[row]);
  if (outside == 0.0) return;
  const auto jump =
      jump_across_panel(kernels_.panels(), dipoles_, densities_.inside, data_, cage_.orientation(), query.y, x);
  if (!jump) return;
  out.columns.row(row) += outside * jump->value;
  for (Eigen::Index i = 0; gradient && i < 3; ++i)
    out.columns.row(row + 1 + i) += outside * jump->gradient[static_cast<size_t>(i)];
}

// What the potentials lack at the closest point.
BoundaryData::Row BoundaryField::missing(const Query& query, const Potentials& at_y, Eigen::Index row) const {
  BoundaryData::Row result(columns_of(query));
  data_.values(query.y.element, query.y.shares, query.y.point, result);
  return result - at_y.columns.row(row).head(result.size());
}

void BoundaryField::evaluate_with_gradient(const Query& query, SolvedRows<3>& out) const {
  const Eigen::Index n = data_.basis_count(), columns = columns_of(query);
  PanelKernels::Tables kernels(kernels_.point_count());
  Potentials at_x, at_y;
  kernels_.fill(query.x, 0, true, query.inside, kernels);
  multiply(kernels, query.inside, columns, at_x);
  continue_beyond_panels(query, query.x, 0, true, at_x);
  BoundaryData::Row values = at_x.columns.row(0);
  std::array<BoundaryData::Row, 3> slopes = {at_x.columns.row(1), at_x.columns.row(2), at_x.columns.row(3)};
  const Vec<3> away = query.x - query.y.point;
  const double distance = away.norm();
  if (query.blend_width > distance) {
    kernels_.fill(query.beside, 0, true, query.inside, kernels);
    multiply(kernels, query.inside, columns, at_y);
    continue_beyond_panels(query, query.beside, 0, true, at_y);
    std::array<BoundaryData::Row, 3> wanted_slopes;
    Mat<3> tangent;
    data_.gradients(query.y, wanted_slopes, tangent);
    const Fade fade(distance, query.blend_width);
    const BoundaryData::Row missing_there = missing(query, at_y, 0);
    values += fade.weight * missing_there;
    for (Eigen::Index k = 0; k < 3; ++k) {
      BoundaryData::Row along = wanted_slopes[static_cast<size_t>(k)].head(columns);
      for (Eigen::Index a = 0; a < 3; ++a) along -= tangent(k, a) * at_y.columns.row(1 + a);
      slopes[static_cast<size_t>(k)] += fade.weight * along + (fade.rate * away[k] / distance) * missing_there;
    }
  }
  if (query.project) {
    BoundaryData::Row projected(n);
    std::array<BoundaryData::Row, 3> gradients;
    if (!project_moments(data_, query.x, values, slopes, projected, gradients)) out.rank_deficient[query.row] = 1;
    values = projected;
    slopes = gradients;
  }
  const auto row = static_cast<Eigen::Index>(query.row);
  set_row(values, out.values, row);
  for (size_t k = 0; k < 3; ++k) set_row(slopes[k], out.gradients[k], row);
}

// Up to four queries of a kind: all with dipoles, all projected, or neither.
void BoundaryField::evaluate_values(std::span<const Query> queries, SolvedRows<3>& out) const {
  const Eigen::Index n = data_.basis_count(), columns = columns_of(queries[0]);
  PanelKernels::Tables kernels(kernels_.point_count());
  Potentials at_x, at_y;
  const auto at = [](size_t i) { return static_cast<Eigen::Index>(i); };
  for (size_t i = 0; i < queries.size(); ++i) kernels_.fill(queries[i].x, at(i), false, queries[i].inside, kernels);
  multiply(kernels, queries[0].inside, columns, at_x);
  if (std::any_of(queries.begin(), queries.end(), [](const Query& query) { return query.blend_width > 0.0; })) {
    for (size_t i = 0; i < queries.size(); ++i)
      if (queries[i].blend_width > 0.0) kernels_.fill(queries[i].beside, at(i), false, queries[i].inside, kernels);
    multiply(kernels, queries[0].inside, columns, at_y);
  }
  for (size_t i = 0; i < queries.size(); ++i) {
    const Query& query = queries[i];
    continue_beyond_panels(query, query.x, at(i), false, at_x);
    BoundaryData::Row values = at_x.columns.row(at(i));
    if (query.blend_width > 0.0) {
      continue_beyond_panels(query, query.beside, at(i), false, at_y);
      const Fade fade(query.y.distance, query.blend_width);
      values += fade.weight * missing(query, at_y, at(i));
    }
    if (query.project) {
      BoundaryData::Row projected(n);
      std::array<BoundaryData::Row, 3> no_gradients;
      if (!project_moments(data_, query.x, values, {}, projected, no_gradients)) out.rank_deficient[query.row] = 1;
      values = projected;
    }
    set_row(values, out.values, at(query.row));
  }
}

void BoundaryField::evaluate(std::span<const Vec<3>> points, bool gradients, SolvedRows<3>& out) const {
  out.resize(points.size(), cage_.control_vertex_count(), gradients);
  std::vector<Query> queries;
  for (size_t i = 0; i < points.size(); ++i) queries.push_back(prepare(points[i], i));
  if (gradients) {
    for (const Query& query : queries) evaluate_with_gradient(query, out);
  } else {
    const auto kind = [](const Query& query) { return 2 * query.inside + query.project; };
    std::stable_sort(queries.begin(), queries.end(), [&](const Query& a, const Query& b) { return kind(a) < kind(b); });
    for (size_t first = 0, end; first < queries.size(); first = end) {
      for (end = first; end < std::min(first + 4, queries.size()) && kind(queries[end]) == kind(queries[first]);) ++end;
      evaluate_values(std::span(queries).subspan(first, end - first), out);
    }
  }
  for (const Query& query : queries) {
    if (!query.on_cage) continue;
    out.on_cage[query.row] = 1;
    BoundaryData::Row basis(data_.basis_count());
    data_.values(query.y.element, query.y.shares, query.y.point, basis);
    set_row(basis, out.values, static_cast<Eigen::Index>(query.row));
  }
}

}  // namespace barycast
