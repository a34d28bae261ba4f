#include "solve/exact_mean_value.h"

#include <algorithm>
#include <limits>
#include <string>

#include "base/tolerances.h"
#include "query/element_distance.h"
#include "solve/closed.h"

namespace barycast {

Status ExactMeanValue::check(const Cage<3>& cage) {
  const auto is_quad = [](const Element& element) { return element.kind == ElementKind::kQuad; };
  if (std::any_of(cage.elements().begin(), cage.elements().end(), is_quad))
    return invalid_argument("estimator",
                            "mean value coordinates have no closed form on bilinear quads; cut them into triangles, or "
                            "choose another estimator");
  if (cage.elements().size() > kExactTrianglesMax)
    return invalid_argument("estimator", "the closed form takes every triangle for every point, and this cage has " +
                                             std::to_string(cage.elements().size()) + ", more than " +
                                             std::to_string(kExactTrianglesMax) + "; sample instead");
  if (!is_closed(cage))
    return invalid_argument("estimator",
                            "the closed form of mean value coordinates reproduces position only on closed cages whose "
                            "faces all face one way; close the cage, or choose another estimator");
  return Done{};
}

Result<std::unique_ptr<const ExactMeanValue>> ExactMeanValue::create(const Cage<3>& cage) {
  if (Status fits = check(cage); !fits) return fits.error();
  return std::unique_ptr<const ExactMeanValue>(new ExactMeanValue(cage));
}

size_t ExactMeanValue::bytes() const {
  return sizeof(*this) - sizeof(mesh_) + mesh_.bytes();
}

void ExactMeanValue::evaluate(std::span<const Vec<3>> points, bool gradients, SolvedRows<3>& out) const {
  out.resize(points.size(), cage_.control_vertex_count(), gradients);
  MeanValueSums sums(mesh_, gradients);
  for (const bool far : {false, true}) {
    PointsAtOnce some;
    std::array<size_t, kPointsAtOnce> rows{};
    size_t count = 0;
    const auto flush = [&] {
      if (count == 0) return;
      for (size_t i = count; i < kPointsAtOnce; ++i) some[i] = some[0];
      far ? add_far_weights(mesh_, some, sums) : add_near_weights(mesh_, some, sums);
      for (size_t i = 0; i < count; ++i)
        if (!sums.on_cage[i]) write_row(i, rows[i], sums, out);
      const auto on_cage = sums.on_cage;
      for (size_t i = 0; i < count; ++i)
        if (on_cage[i]) write_on_cage(some[i], rows[i], sums, out);
      count = 0;
    };
    for (size_t row = 0; row < points.size(); ++row) {
      if ((points[row].squaredNorm() > kExactFar * kExactFar) != far) continue;
      some[count] = points[row];
      rows[count++] = row;
      if (count == kPointsAtOnce) flush();
    }
    flush();
  }
}

void ExactMeanValue::write_row(size_t lane, size_t row, const MeanValueSums& sums, SolvedRows<3>& out) const {
  const auto at = static_cast<Eigen::Index>(lane), to = static_cast<Eigen::Index>(row);
  const auto control_vertices = static_cast<Eigen::Index>(cage_.control_vertex_count());
  const auto nodes = static_cast<Eigen::Index>(mesh_.nodes.size());
  const auto spread = [&](auto&& weights, auto&& values) {
    values = weights.head(control_vertices);
    for (Eigen::Index node = control_vertices; node < nodes; ++node)
      for (const auto& [vertex, share] : cage_.stencil(static_cast<uint32_t>(node)))
        values[static_cast<Eigen::Index>(vertex)] += share * weights[node];
  };
  auto values = out.values.row(to);
  spread(sums.weights.row(at), values);
  const double total = values.sum();
  values /= total;
  if (sums.gradients.size() == 0) return;
  for (Eigen::Index k = 0; k < 3; ++k) {
    using Partial = Eigen::Map<const Eigen::RowVectorXd, 0, Eigen::InnerStride<>>;
    auto partial = out.gradients[static_cast<size_t>(k)].row(to);
    spread(Partial(sums.gradients.data() + 4 * k + at, nodes, Eigen::InnerStride<>(12)), partial);
    partial = (partial - partial.sum() * values) / total;
  }
}

ExactMeanValue::Location ExactMeanValue::closest(const Vec<3>& x) const {
  Location best{nullptr, {}};
  double least = std::numeric_limits<double>::infinity();
  for (const Element& element : cage_.elements()) {
    const auto y = closest_on_triangle(x, cage_.corner(element, 0), cage_.corner(element, 1), cage_.corner(element, 2));
    if (y.distance_squared >= least) continue;
    least = y.distance_squared;
    best = {&element, y.shares};
  }
  return best;
}

void ExactMeanValue::write_on_cage(const Vec<3>& x, size_t row, MeanValueSums& sums, SolvedRows<3>& out) const {
  const Location y = closest(x);
  const auto to = static_cast<Eigen::Index>(row);
  if (sums.gradients.size() > 0) {
    const Vec<3> inward = -cage_.orientation() * element_normal(cage_, *y.element, y.shares);
    PointsAtOnce off;
    for (size_t i = 0; i < kPointsAtOnce; ++i)  // outside, and further, where faces touch
      off[i] = x + inward * (kExactGradientShift * (i % 2 == 0 ? 1.0 : -1.0) * (i < 2 ? 1.0 : 1.5));
    add_near_weights(mesh_, off, sums);
    const auto free = std::find(sums.on_cage.begin(), sums.on_cage.end(), false);
    if (free != sums.on_cage.end()) write_row(static_cast<size_t>(free - sums.on_cage.begin()), row, sums, out);
  }
  std::vector<VertexWeight> basis;
  cage_.append_basis(*y.element, std::span<const double>(y.shares).first(3), 1.0, basis);
  out.values.row(to).setZero();
  for (const auto& [vertex, share] : basis) out.values(to, static_cast<Eigen::Index>(vertex)) += share;
  out.on_cage[row] = 1;
}

}  // namespace barycast
