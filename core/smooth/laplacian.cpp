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

// The face's Laplacian in the notation of the paper: D takes differences along edges, B their averages,
// U is the gradient (sharp), V the projection of a vector onto edges (flat), P what of a one-form no
// gradient explains; M = a U^T U + P^T P is the inner product of one-forms.
// Empty when the face has no area.
Eigen::MatrixXd face_laplacian(const Eigen::MatrixX3d& corners, double& area) {
  const Eigen::Index n = corners.rows();
  Eigen::MatrixXd difference = Eigen::MatrixXd::Zero(n, n);
  Eigen::MatrixX3d averages(n, 3);
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

  const Vec<3> normal = area_vector / area;
  Eigen::Matrix3Xd sharp(3, n);
  for (Eigen::Index i = 0; i < n; ++i) sharp.col(i) = normal.cross(Vec<3>(averages.row(i).transpose())) / area;
  const Eigen::MatrixX3d edges = difference * corners;
  const Eigen::MatrixX3d flat = edges - (edges * normal) * normal.transpose();
  const Eigen::MatrixXd unexplained = Eigen::MatrixXd::Identity(n, n) - flat * sharp;
  const Eigen::MatrixXd inner = area * sharp.transpose() * sharp + unexplained.transpose() * unexplained;
  return difference.transpose() * inner * difference;
}

}  // namespace

std::optional<MeshLaplacian> polygon_laplacian(const QueryMesh& mesh, const std::atomic<bool>& cancel) {
  MeshLaplacian result;
  const auto count = static_cast<Eigen::Index>(mesh.nodes.size());
  result.area = Eigen::VectorXd::Zero(count);
  std::vector<Eigen::Triplet<double>> entries;
  for (size_t f = 0; f < mesh.face_count(); ++f) {
    if (is_cancelled(f, cancel)) return std::nullopt;
    const auto face = mesh.face(f);
    if (face.size() > kFaceCornersMax) {
      ++result.faces_skipped;
      continue;
    }
    const auto n = static_cast<Eigen::Index>(face.size());
    Eigen::MatrixX3d corners(n, 3);
    for (Eigen::Index i = 0; i < n; ++i) corners.row(i) = mesh.nodes[face[static_cast<size_t>(i)]].transpose();
    double area = 0.0;
    const Eigen::MatrixXd local = face_laplacian(corners, area);
    if (local.size() == 0) {
      ++result.faces_skipped;
      continue;
    }
    for (Eigen::Index i = 0; i < n; ++i) {
      const auto row = static_cast<int>(face[static_cast<size_t>(i)]);
      result.area[row] += area / static_cast<double>(n);
      for (Eigen::Index j = 0; j < n; ++j)
        entries.emplace_back(row, static_cast<int>(face[static_cast<size_t>(j)]), local(i, j));
    }
  }
  result.stiffness.resize(count, count);
  result.stiffness.setFromTriplets(entries.begin(), entries.end());
  return result;
}

}  // namespace barycast
