#include "solve/boundary_data.h"

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <cmath>
#include <vector>

namespace barycast {
namespace {

// Shares as small as this are on the border of their element but for rounding.
constexpr double kShareOnEdge = 1e-12;

// The directions in which a closest point moves with its query, as changes of the corner shares, and as vectors.
struct Directions {
  std::array<std::array<double, 4>, 2> shares{};
  Eigen::Matrix<double, 3, 2> vectors = Eigen::Matrix<double, 3, 2>::Zero();
  int count = 0;
};

Directions free_directions(const Cage<3>& cage, const CagePoint<3>& y) {
  const Element& element = cage.elements()[y.element];
  Directions result;
  const auto add = [&](const std::array<double, 4>& change) {
    Vec<3> vector = Vec<3>::Zero();
    for (int i = 0; i < element.corner_count(); ++i) vector += change[static_cast<size_t>(i)] * cage.corner(element, i);
    result.shares[static_cast<size_t>(result.count)] = change;
    result.vectors.col(result.count++) = vector;
  };
  const auto& s = y.shares;
  if (element.kind == ElementKind::kQuad) {
    const double u = s[1] + s[2], v = s[2] + s[3];
    if (u > kShareOnEdge && u < 1 - kShareOnEdge) add({-(1 - v), 1 - v, v, -v});
    if (v > kShareOnEdge && v < 1 - kShareOnEdge) add({-(1 - u), -u, u, 1 - u});
    return result;
  }
  const std::array<bool, 3> off = {s[0] <= kShareOnEdge, s[1] <= kShareOnEdge, s[2] <= kShareOnEdge};
  const int off_count = off[0] + off[1] + off[2];
  if (off_count >= 2) return result;
  if (off_count == 0 || off[2]) add({-1, 1, 0, 0});
  if (off_count == 0 || off[1]) add({-1, 0, 1, 0});
  if (off_count == 1 && off[0]) add({0, -1, 1, 0});
  return result;
}

constexpr std::array<std::array<Eigen::Index, 2>, 6> kPairs = {{{0, 0}, {0, 1}, {0, 2}, {1, 1}, {1, 2}, {2, 2}}};

}  // namespace

BoundaryData::BoundaryData(const Cage<3>& cage, bool moments)
    : cage_(cage), moments_(moments), column_of_vertex_(cage.control_vertex_count(), -1) {
  Eigen::Index column = 0;
  for (const uint32_t v : cage.used_vertices()) column_of_vertex_[v] = column++;
  if (!moments) return;
  const auto n = static_cast<double>(column);
  for (const uint32_t v : cage.used_vertices()) centre_ += cage.control_vertices()[v] / n;
  Mat<3> covariance = Mat<3>::Zero();
  for (const uint32_t v : cage.used_vertices()) {
    const Vec<3> off = cage.control_vertices()[v] - centre_;
    covariance += off * off.transpose() / n;
  }
  // None is 0: Cage::create refuses what is flatter than kSpanRatioMin.
  const Eigen::SelfAdjointEigenSolver<Mat<3>> solver(covariance);
  for (Eigen::Index i = 0; i < 3; ++i)
    spread_.row(i) = solver.eigenvectors().col(i).transpose() / std::sqrt(solver.eigenvalues()[i]);
}

void BoundaryData::entries(uint32_t element, const std::array<double, 4>& shares, const Vec<3>& y,
                           std::vector<Entry>& out) const {
  out.clear();
  std::vector<VertexWeight> basis;
  cage_.append_basis(cage_.elements()[element], shares, 1.0, basis);
  const Eigen::Index n = basis_count();
  const Vec<3> z = to_moments(y);
  for (const VertexWeight& phi : basis) {
    const Eigen::Index column = column_of_vertex_[phi.vertex];
    out.push_back({column, phi.weight});
    for (Eigen::Index a = 0; a < 3 && moments_; ++a) out.push_back({n + 3 * column + a, phi.weight * z[a]});
  }
  for (size_t p = 0; p < 6 && moments_; ++p)
    out.push_back({4 * n + static_cast<Eigen::Index>(p), z[kPairs[p][0]] * z[kPairs[p][1]]});
}

void BoundaryData::values(uint32_t element, const std::array<double, 4>& shares, const Vec<3>& y,
                          Eigen::Ref<Row> out) const {
  out.setZero();
  std::vector<Entry> some;
  entries(element, shares, y, some);
  for (const Entry& entry : some)
    if (entry.column < out.size()) out[entry.column] += entry.value;
}

void BoundaryData::gradients(const CagePoint<3>& y, std::array<Row, 3>& out, Mat<3>& tangent) const {
  const Eigen::Index n = basis_count();
  for (Row& partial : out) partial.setZero(count());
  tangent.setZero();
  const Directions directions = free_directions(cage_, y);
  if (directions.count == 0) return;
  // Columns: the change of the free parameters per movement of y; with one direction, along it.
  const auto vectors = directions.vectors.leftCols(directions.count);
  const Eigen::Matrix<double, Eigen::Dynamic, 3> parameters = vectors.completeOrthogonalDecomposition().pseudoInverse();
  tangent = vectors * parameters;
  const Mat<3> z_change = spread_ * tangent;
  const Vec<3> z = to_moments(y.point);
  std::vector<VertexWeight> basis, change;
  const Element& element = cage_.elements()[y.element];
  cage_.append_basis(element, y.shares, 1.0, basis);
  for (Eigen::Index k = 0; k < 3; ++k) {
    Row& partial = out[static_cast<size_t>(k)];
    change.clear();
    for (int i = 0; i < directions.count; ++i)
      cage_.append_basis(element, directions.shares[static_cast<size_t>(i)], parameters(i, k), change);
    for (const VertexWeight& phi : change) {
      const Eigen::Index column = column_of_vertex_[phi.vertex];
      partial[column] += phi.weight;
      for (Eigen::Index a = 0; a < 3 && moments_; ++a) partial[n + 3 * column + a] += phi.weight * z[a];
    }
    if (!moments_) continue;
    for (const VertexWeight& phi : basis)
      for (Eigen::Index a = 0; a < 3; ++a)
        partial[n + 3 * column_of_vertex_[phi.vertex] + a] += phi.weight * z_change(a, k);
    for (size_t p = 0; p < 6; ++p) {
      const auto [a, b] = kPairs[p];
      partial[4 * n + Eigen::Index(p)] = z_change(a, k) * z[b] + z[a] * z_change(b, k);
    }
  }
}

}  // namespace barycast
