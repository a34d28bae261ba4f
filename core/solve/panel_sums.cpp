#include "solve/panel_sums.h"

#include <algorithm>

#include "base/check.h"

namespace barycast {
namespace {

// Distances, in radii of a panel, from which three points stand for it, from which seven do, and from which floats will
// do for its exact potential.
constexpr double kThreePointRadii = 12.0;
constexpr double kSevenPointRadii = 5.0;
constexpr double kFloatRadii = 1.25;

size_t rounded_up(Eigen::Index columns) {
  return (static_cast<size_t>(columns) + kSumLanes - 1) / kSumLanes * kSumLanes;
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

// Arrays of a batch, all aligned as vectors want it.
struct PanelSums::Workspace {
  using Floats = hwy::AlignedFreeUniquePtr<float[]>;
  size_t rows, columns;  // columns rounded up
  Floats x, kernels, sums, corner_sums, basis_sums, enclosed;
  hwy::AlignedFreeUniquePtr<double[]> exact_x;

  Workspace(size_t row_count, size_t column_count, size_t basis_count)
      : rows(row_count),
        columns(column_count),
        x(hwy::AllocateAligned<float>(3 * kSumPoints)),
        kernels(hwy::AllocateAligned<float>(rows * 3 * kSumPanels * kSumPoints)),
        sums(hwy::AllocateAligned<float>(rows * kSumPoints * columns)),
        corner_sums(hwy::AllocateAligned<float>(rows * 4 * kSumPoints)),
        basis_sums(hwy::AllocateAligned<float>(rows * basis_count * kSumPoints)),
        enclosed(hwy::AllocateAligned<float>(kSumPoints)),
        exact_x(hwy::AllocateAligned<double>(3 * kSumPoints)) {}

  void clear(size_t basis_count) {
    std::fill_n(sums.get(), rows * kSumPoints * columns, 0.0f);
    std::fill_n(corner_sums.get(), rows * 4 * kSumPoints, 0.0f);
    std::fill_n(basis_sums.get(), rows * basis_count * kSumPoints, 0.0f);
    std::fill_n(enclosed.get(), kSumPoints, 0.0f);
  }
};

PanelSums::PanelSums(const Panels& panels, const BoundaryData& data, const DensityGroups& densities,
                     const DoubleLayer* dipoles)
    : column_count_(densities.size() == DensityColumn::groups(data.basis_count()) ? data.basis_count() : data.count()),
      basis_count_(data.basis_count()),
      stride_(rounded_up(column_count_)) {
  const size_t points = 3 * panels.panels.size();
  for (const Panel& panel : panels.panels) {
    points_.push_back(sum_points(panel));
    triangles_.push_back(sum_triangle<float>(panel));
    exact_triangles_.push_back(sum_triangle<double>(panel));
  }
  densities_ = hwy::AllocateAligned<float>(points * stride_);
  std::fill_n(densities_.get(), points * stride_, 0.0f);
  for (Eigen::Index column = 0; column < column_count_; ++column) {
    const DensityColumn at(column, data);
    for (size_t i = 0; i < points; ++i)
      densities_[i * stride_ + static_cast<size_t>(column)] =
          static_cast<float>(densities[at.group](static_cast<Eigen::Index>(i), at.lane));
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
          .densities = densities_.get(),
          .density_stride = stride_,
          .shares = shares_,
          .elements = elements_,
          .entries = entries_,
          .basis_count = static_cast<size_t>(basis_count_)};
}

size_t PanelSums::bytes() const {
  return sizeof(*this) +
         points_.size() * (sizeof(SumPoints) + sizeof(SumTriangle<float>) + sizeof(SumTriangle<double>)) +
         3 * points_.size() * stride_ * sizeof(float) + shares_.size() * sizeof(shares_[0]) +
         elements_.size() * sizeof(SumElement) + entries_.size() * sizeof(SumEntry);
}

void PanelSums::evaluate(std::span<const Vec<3>> points, Eigen::Index columns, bool gradients, Rows& out) const {
  BARYCAST_CHECK_OP(columns, <=, column_count_);
  const auto rows = static_cast<Eigen::Index>(points.size());
  out.values.resize(rows, columns);
  for (auto& partial : out.gradients) partial.resize(gradients ? rows : 0, gradients ? columns : 0);
  out.enclosed.resize(shares_.empty() ? 0 : points.size());
  Workspace work(gradients ? 4 : 1, rounded_up(columns), static_cast<size_t>(basis_count_));
  for (size_t first = 0; first < points.size(); first += kSumPoints)
    evaluate_batch(points.subspan(first, std::min(kSumPoints, points.size() - first)), first, gradients, work, out);
}

void PanelSums::evaluate_batch(std::span<const Vec<3>> points, size_t first, bool gradients, Workspace& work,
                               Rows& out) const {
  const auto basis_count = static_cast<size_t>(basis_count_);
  work.clear(basis_count);
  SumBatch batch{.lanes = rounded_up(static_cast<Eigen::Index>(points.size())),
                 .x = {},
                 .exact_x = {},
                 .kernels = work.kernels.get(),
                 .sums = work.sums.get(),
                 .corner_sums = work.corner_sums.get(),
                 .basis_sums = work.basis_sums.get(),
                 .enclosed = work.enclosed.get()};
  for (size_t k = 0; k < 3; ++k) {
    batch.x[k] = work.x.get() + k * kSumPoints;
    batch.exact_x[k] = work.exact_x.get() + k * kSumPoints;
    for (size_t i = 0; i < batch.lanes; ++i) {  // empty lanes repeat the last point
      const double x = points[std::min(i, points.size() - 1)][static_cast<Eigen::Index>(k)];
      work.exact_x[k * kSumPoints + i] = x;
      work.x[k * kSumPoints + i] = static_cast<float>(x);
    }
  }
  add_panel_sums(tables(), gradients, work.columns, batch);
  const auto columns = out.values.cols();
  for (size_t r = 0; r < work.rows; ++r) {
    Rows::Table& table = r == 0 ? out.values : out.gradients[r - 1];
    for (size_t i = 0; i < points.size(); ++i) {
      float* const row = table.data() + static_cast<Eigen::Index>(first + i) * columns;
      std::copy_n(batch.sums + (r * kSumPoints + i) * work.columns, columns, row);
      if (shares_.empty()) continue;
      const float* const basis = batch.basis_sums + r * basis_count * kSumPoints + i;
      for (size_t v = 0; v < std::min(basis_count, static_cast<size_t>(columns)); ++v) row[v] += basis[v * kSumPoints];
    }
  }
  if (!shares_.empty())
    std::copy_n(batch.enclosed, points.size(), out.enclosed.begin() + static_cast<ptrdiff_t>(first));
}

}  // namespace barycast
