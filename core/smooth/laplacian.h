#pragma once

// The polygon Laplacian of de Goes, Butts and Desbrun 2020 over a query mesh, with vertex areas: for
// triangles the cotangent Laplacian, for any planar or non-planar polygon a consistent extension.
// Zero-area faces are skipped. Linear in the mesh; dense algebra per face.

#include <Eigen/SparseCore>
#include <atomic>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/vector.h"

namespace barycast {

// Nodes are the distinct positions of the query points; a mesh in the plane has z = 0.
struct QueryMesh {
  std::vector<Vec<3>> nodes;
  std::vector<uint32_t> face_offsets;  // k + 1
  std::vector<uint32_t> face_nodes;

  size_t face_count() const { return face_offsets.empty() ? 0 : face_offsets.size() - 1; }
  std::span<const uint32_t> face(size_t i) const {
    return {face_nodes.data() + face_offsets[i], face_offsets[i + 1] - face_offsets[i]};
  }
  // By node, whether a face names it.
  std::vector<bool> nodes_with_faces() const {
    std::vector<bool> result(nodes.size(), false);
    for (const uint32_t node : face_nodes) result[node] = true;
    return result;
  }
};

struct MeshLaplacian {
  // L, symmetric positive semi-definite, rows sum to zero: the lower triangle.
  Eigen::SparseMatrix<double> stiffness;
  Eigen::VectorXd area;      // diagonal of A; 0 where a node belongs to no face with area
  size_t faces_skipped = 0;  // without area, or with more than 256 corners
};

// Nothing: `cancel` was seen set.
std::optional<MeshLaplacian> polygon_laplacian(const QueryMesh& mesh, const std::atomic<bool>& cancel);

}  // namespace barycast
