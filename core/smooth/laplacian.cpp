#include "smooth/laplacian.h"

#include <algorithm>
#include <cmath>

#include "base/cancel.h"
#include "base/tolerances.h"

namespace barycast {
namespace {

// Larger faces are skipped: their dense algebra would cost more than all others together, and what
// they would connect is far apart.
constexpr size_t kFaceCornersMax = 256;

// Faces of few corners need no memory from the heap.
constexpr int kFewCorners = 8;

// n x 3
template <int Max>
using Corners = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::ColMajor, Max, 3>;
template <int Max>
using Square = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, Max, Max>;

// Of a triangle, with the edges opposite its corners: L_ij = e_i . e_j / 4a, half the cotangents.
template <int Max>
Square<Max> triangle_laplacian(const Corners<Max>& corners, double area) {
  Eigen::Matrix3d edges;  // a row each
  for (Eigen::Index i = 0; i < 3; ++i) edges.row(i) = corners.row((i + 2) % 3) - corners.row((i + 1) % 3);
  return edges * edges.transpose() / (4.0 * area);
}

// The face's Laplacian in the notation of the paper: D takes differences along edges, B their averages,
// U is the gradient (sharp), V the projection of a vector onto edges (flat), P what of a one-form no
// gradient explains; M = a U^T U + P^T P is the inner product of one-forms.
// Empty when the face has no area.
template <int Max>
Square<Max> face_laplacian(const Corners<Max>& corners, double& area) {
  const Eigen::Index n = corners.rows();
  Square<Max> difference = Square<Max>::Zero(n, n);
  Corners<Max> averages(n, 3);
  Vec<3> area_vector = Vec<3>::Zero();
  const Vec<3> centre = corners.colwise().mean();
  double edge_squared = 0.0;
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Index next = (i + 1) % n;
    difference(i, i) = -1.0;
    difference(i, next) = 1.0;
    averages.row(i) = 0.5 * (corners.row(i) + corners.row(next)) - centre.transpose();
    const Vec<3> a = corners.row(i).transpose() - centre, b = corners.row(next).transpose() - centre;
    area_vector += 0.5 * a.cross(b);
    edge_squared = std::max(edge_squared, (b - a).squaredNorm());
  }
  area = area_vector.norm();
  if (!(area > kFaceAreaMin * edge_squared)) return {};
  if (n == 3) return triangle_laplacian<Max>(corners, area);

  const Vec<3> normal = area_vector / area;
  Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::ColMajor, 3, Max> sharp(3, n);
  for (Eigen::Index i = 0; i < n; ++i) sharp.col(i) = normal.cross(Vec<3>(averages.row(i).transpose())) / area;
  const Corners<Max> edges = difference * corners;
  const Corners<Max> flat = edges - (edges * normal) * normal.transpose();
  const Square<Max> unexplained = Square<Max>::Identity(n, n) - flat * sharp;
  const Square<Max> inner = area * sharp.transpose() * sharp + unexplained.transpose() * unexplained;
  return difference.transpose() * inner * difference;
}

// Adds a face to the lower triangle. False: it has no area.
template <int Max>
bool add_face(const QueryMesh& mesh, std::span<const uint32_t> face, Eigen::VectorXd& node_area,
              std::vector<Eigen::Triplet<double>>& entries) {
  const auto n = static_cast<Eigen::Index>(face.size());
  Corners<Max> corners(n, 3);
  for (Eigen::Index i = 0; i < n; ++i) corners.row(i) = mesh.nodes[face[static_cast<size_t>(i)]].transpose();
  double area = 0.0;
  const Square<Max> local = face_laplacian<Max>(corners, area);
  if (local.size() == 0) return false;
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto row = static_cast<int>(face[static_cast<size_t>(i)]);
    node_area[row] += area / static_cast<double>(n);
    for (Eigen::Index j = 0; j < n; ++j) {
      const auto column = static_cast<int>(face[static_cast<size_t>(j)]);
      if (row >= column) entries.emplace_back(row, column, local(i, j));
    }
  }
  return true;
}

}  // namespace

std::optional<MeshLaplacian> polygon_laplacian(const QueryMesh& mesh, const std::atomic<bool>& cancel) {
  MeshLaplacian result;
  const auto count = static_cast<Eigen::Index>(mesh.nodes.size());
  result.area = Eigen::VectorXd::Zero(count);
  std::vector<Eigen::Triplet<double>> entries;
  size_t triangle_entries = 0;
  for (size_t f = 0; f < mesh.face_count(); ++f) {
    const size_t n = mesh.face(f).size();
    if (n <= kFaceCornersMax) triangle_entries += n * (n + 1) / 2;
  }
  entries.reserve(triangle_entries);
  for (size_t f = 0; f < mesh.face_count(); ++f) {
    if (is_cancelled(f, cancel)) return std::nullopt;
    const auto face = mesh.face(f);
    const bool added = face.size() <= kFewCorners       ? add_face<kFewCorners>(mesh, face, result.area, entries)
                       : face.size() <= kFaceCornersMax ? add_face<Eigen::Dynamic>(mesh, face, result.area, entries)
                                                        : false;
    if (!added) ++result.faces_skipped;
  }
  result.stiffness.resize(count, count);
  result.stiffness.setFromTriplets(entries.begin(), entries.end());
  return result;
}

}  // namespace barycast
