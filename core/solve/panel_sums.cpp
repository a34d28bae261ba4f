#include "solve/panel_sums.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>

#include "base/check.h"

namespace barycast {
namespace {

// Distances, in radii of a panel, from which three points stand for it, from which seven do, and from which floats will
// do for its exact potential. Nearer than PanelKernels has them: floats round exact potentials by more than the rules
// are off by. Eight radii instead of ten save 1 to 12% and take densities that jump wildly beyond 1e-5.
constexpr double kThreePointRadii = 10.0;
constexpr double kSevenPointRadii = 4.0;
constexpr double kFloatRadii = 1.25;

size_t rounded_up(size_t count) {
  return sum_lines(count) * kSumLanes;
}

template <class T>
std::array<T, 3> to_array(const Vec<3>& v) {
  return {static_cast<T>(v[0]), static_cast<T>(v[1]), static_cast<T>(v[2])};
}

template <class T>
SumTriangle<T> sum_triangle(const Panel& panel) {
  SumTriangle<T> out;
  out.centre = to_array<T>(panel.centre);
  out.normal = to_array<T>(panel.normal);
  out.area = static_cast<T>(panel.area);
  for (size_t e = 0; e < 3; ++e) {
    const Vec<3> from = panel.corner[e] - panel.centre, side = panel.corner[(e + 1) % 3] - panel.corner[e];
    const Vec<3> along = side.normalized(), outward = along.cross(panel.normal);
    out.corner[e] = to_array<T>(from);
    out.along[e] = to_array<T>(along);
    out.outward[e] = to_array<T>(outward);
    out.length[e] = static_cast<T>(side.norm());
    out.start[e] = static_cast<T>(from.dot(along));
    out.distance[e] = static_cast<T>(from.dot(outward));
    out.slope[e] = to_array<T>(panel.gradient[e]);
    for (size_t k = 0; k < 3; ++k) {
      out.across[k][e] = static_cast<T>(panel.gradient[k].dot(outward));
      out.alongside[k][e] = static_cast<T>(panel.gradient[k].dot(along));
    }
  }
  return out;
}

SumPoints sum_points(const Panel& panel) {
  SumPoints out;
  out.centre = to_array<float>(panel.centre);
  out.normal = to_array<float>(panel.normal);
  out.charge = static_cast<float>(panel.area / 3);
  for (size_t k = 0; k < 3; ++k) out.point[k] = to_array<float>(panel.point[k] - panel.centre);
  for (size_t j = 0; j < kTriangleRule.size(); ++j) {
    const auto& [barycentric, weight] = kTriangleRule[j];
    Vec<3> point = Vec<3>::Zero();
    for (size_t k = 0; k < 3; ++k) point += barycentric[k] * (panel.corner[k] - panel.centre);
    out.rule[j] = to_array<float>(point);
    for (size_t k = 0; k < 3; ++k)
      out.rule_charge[j][k] = static_cast<float>(panel.area * weight * (2 * barycentric[k] - 1 / 3.0));
  }
  const auto squared = [&](double radii) { return static_cast<float>(radii * radii * panel.radius * panel.radius); };
  out.three_point_squared = squared(kThreePointRadii);
  out.seven_point_squared = squared(kSevenPointRadii);
  out.exact_squared = squared(kFloatRadii);
  return out;
}

}  // namespace

// Arrays of a batch.
struct PanelSums::Evaluator::Workspace {
  using Lines = std::vector<SumLine>;
  size_t rows, columns;  // columns rounded up
  alignas(64) std::array<std::array<float, kSumPoints>, 3> x;
  alignas(64) std::array<std::array<double, kSumPoints>, 3> exact_x;
  Lines kernels, sums, corner_sums, basis_sums, enclosed;

  Workspace(size_t row_count, size_t column_count, size_t basis_count)
      : rows(row_count),
        columns(column_count),
        kernels(lines(rows * kSumRows * kSumPoints)),
        sums(lines(rows * kSumPoints * columns)),
        corner_sums(lines(rows * 4 * kSumPoints)),
        basis_sums(lines(rows * basis_count * kSumPoints)),
        enclosed(lines(kSumPoints)) {}

  static Lines lines(size_t floats) { return Lines(floats / kSumLanes); }
  static float* data(Lines& lines) { return reinterpret_cast<float*>(lines.data()); }

  // For the next batch. Empty lanes repeat the last point.
  SumBatch start(std::span<const Vec<3>> points) {
    const size_t lanes = rounded_up(points.size());
    for (size_t r = 0; r < rows; ++r) std::fill_n(data(sums) + r * kSumPoints * columns, lanes * columns, 0.0f);
    for (Lines* const some : {&corner_sums, &basis_sums, &enclosed})
      for (size_t i = 0; i < some->size(); i += kSumPoints / kSumLanes)
        std::fill_n(some->begin() + static_cast<ptrdiff_t>(i), lanes / kSumLanes, SumLine{});
    SumBatch batch{.points = points.size(),
                   .lanes = lanes,
                   .x = {x[0].data(), x[1].data(), x[2].data()},
                   .exact_x = {exact_x[0].data(), exact_x[1].data(), exact_x[2].data()},
                   .kernels = data(kernels),
                   .sums = data(sums),
                   .corner_sums = data(corner_sums),
                   .basis_sums = data(basis_sums),
                   .enclosed = data(enclosed)};
    for (size_t k = 0; k < 3; ++k)
      for (size_t i = 0; i < batch.lanes; ++i) {
        exact_x[k][i] = points[std::min(i, points.size() - 1)][static_cast<Eigen::Index>(k)];
        x[k][i] = static_cast<float>(exact_x[k][i]);
      }
    return batch;
  }
};

PanelSums::PanelSums(const Panels& panels, const BoundaryData& data, const DensityGroups& densities,
                     const DoubleLayer* dipoles)
    : column_count_(densities.size() == DensityColumn::groups(data.basis_count()) ? data.basis_count() : data.count()),
      basis_count_(data.basis_count()) {
  const size_t points = 3 * panels.panels.size();
  all_panels_.resize(panels.panels.size());
  std::iota(all_panels_.begin(), all_panels_.end(), 0u);
  for (const Panel& panel : panels.panels) {
    points_.push_back(sum_points(panel));
    triangles_.push_back(sum_triangle<float>(panel));
    exact_triangles_.push_back(sum_triangle<double>(panel));
  }
  const size_t lines = sum_lines(static_cast<size_t>(column_count_));
  densities_.resize(points * lines);
  for (Eigen::Index column = 0; column < column_count_; ++column) {
    const DensityColumn from(column, data);
    const auto to = static_cast<size_t>(column);
    for (size_t i = 0; i < points; ++i)
      densities_[i * lines + to / kSumLanes].lane[to % kSumLanes] =
          static_cast<float>(densities[from.group](static_cast<Eigen::Index>(i), from.lane));
  }
  if (dipoles != nullptr) add_dipoles(*dipoles, panels);
}

void PanelSums::add_dipoles(const DoubleLayer& dipoles, const Panels& panels) {
  for (size_t p = 0; p < panels.panels.size(); ++p) {
    auto& shares = shares_.emplace_back();
    for (size_t k = 0; k < 3; ++k)
      for (size_t c = 0; c < 4; ++c)
        shares[k][c] = static_cast<float>(dipoles.factor() * dipoles.shares(3 * p + k)[static_cast<Eigen::Index>(c)]);
    const uint32_t element = panels.panels[p].element;
    if (p + 1 < panels.panels.size() && panels.panels[p + 1].element == element) continue;
    for (uint32_t c = 0; c < 4; ++c)
      for (const BoundaryData::Entry& entry : dipoles.corner_basis(element, c))
        entries_.push_back({c, static_cast<uint32_t>(entry.column), static_cast<float>(entry.value)});
    elements_.push_back({static_cast<uint32_t>(p + 1), static_cast<uint32_t>(entries_.size())});
  }
}

SumTables PanelSums::tables() const {
  return {.points = points_,
          .triangles = triangles_,
          .exact_triangles = exact_triangles_,
          .densities = reinterpret_cast<const float*>(densities_.data()),
          .density_stride = rounded_up(static_cast<size_t>(column_count_)),
          .shares = shares_,
          .elements = elements_,
          .entries = entries_,
          .basis_count = static_cast<size_t>(basis_count_)};
}

double PanelSums::charge(size_t panel, size_t column) const {
  const size_t lines = sum_lines(static_cast<size_t>(column_count_));
  float sum = 0.0f;
  for (size_t k = 0; k < 3; ++k)
    sum += std::abs(densities_[(3 * panel + k) * lines + column / kSumLanes].lane[column % kSumLanes]);
  return double{sum * points_[panel].charge};
}

size_t PanelSums::bytes() const {
  return sizeof(*this) +
         points_.size() * (sizeof(SumPoints) + sizeof(SumTriangle<float>) + sizeof(SumTriangle<double>)) +
         densities_.size() * sizeof(SumLine) + shares_.size() * sizeof(shares_[0]) +
         elements_.size() * sizeof(SumElement) + entries_.size() * sizeof(SumEntry) +
         all_panels_.size() * sizeof(uint32_t);
}

size_t PanelSums::bytes(size_t panels, size_t columns) {
  // The lists grow by doubling.
  const size_t lists = sizeof(SumPoints) + sizeof(SumTriangle<float>) + sizeof(SumTriangle<double>) +
                       sizeof(std::array<std::array<float, 4>, 3>) + sizeof(uint32_t);
  return std::bit_ceil(panels) * lists + 3 * panels * rounded_up(columns) * sizeof(float);
}

size_t PanelSums::evaluation_bytes(size_t points, size_t columns, size_t basis, bool gradients) {
  const size_t rows = gradients ? 4 : 1, lanes = kSumPoints * rounded_up(columns);
  return rows * sizeof(float) * (points * columns + kSumRows * kSumPoints + lanes + kSumPoints * (4 + basis));
}

PanelSums::Evaluator::Evaluator(const PanelSums& sums, size_t points, Eigen::Index columns, bool gradients, Rows& out)
    : sums_(sums),
      out_(out),
      gradients_(gradients),
      work_(std::make_unique<Workspace>(gradients ? 4 : 1, rounded_up(static_cast<size_t>(columns)),
                                        static_cast<size_t>(sums.basis_count_))) {
  BARYCAST_CHECK_OP(columns, <=, sums.column_count_);
  const auto rows = static_cast<Eigen::Index>(points);
  out.values.resize(rows, columns);
  for (auto& partial : out.gradients) partial.resize(gradients ? rows : 0, gradients ? columns : 0);
  out.enclosed.resize(sums.shares_.empty() ? 0 : points);
}

PanelSums::Evaluator::~Evaluator() = default;

void PanelSums::Evaluator::fill(const Part& part, std::span<const Vec<3>> points, std::span<const size_t> rows) {
  const auto basis_count = static_cast<size_t>(sums_.basis_count_);
  const bool dipoles = !sums_.shares_.empty();
  const SumBatch batch = work_->start(points);
  add_panel_sums(sums_.tables(), part.panels, gradients_, work_->columns, batch);
  if (part.others != nullptr) add_expansion(*part.others, gradients_, work_->columns, batch);
  const auto columns = static_cast<size_t>(out_.values.cols());
  for (size_t r = 0; r < work_->rows; ++r) {
    Rows::Table& table = r == 0 ? out_.values : out_.gradients[r - 1];
    for (size_t i = 0; i < points.size(); ++i) {
      float* const row = table.data() + rows[i] * columns;
      std::copy_n(batch.sums + (r * kSumPoints + i) * work_->columns, columns, row);
      if (!dipoles) continue;
      const float* const basis = batch.basis_sums + r * basis_count * kSumPoints + i;
      for (size_t v = 0; v < std::min(basis_count, columns); ++v) row[v] += basis[v * kSumPoints];
    }
  }
  for (size_t i = 0; dipoles && i < points.size(); ++i) out_.enclosed[rows[i]] = batch.enclosed[i];
}

void PanelSums::evaluate(std::span<const Vec<3>> points, Eigen::Index columns, bool gradients, Rows& out) const {
  Evaluator evaluator(*this, points.size(), columns, gradients, out);
  std::array<size_t, kSumPoints> rows;
  for (size_t first = 0; first < points.size(); first += kSumPoints) {
    const size_t count = std::min(kSumPoints, points.size() - first);
    std::iota(rows.begin(), rows.end(), first);
    evaluator.fill({.panels = all_panels_}, points.subspan(first, count), std::span(rows).first(count));
  }
}

}  // namespace barycast
