#include "bind/cost.h"

#include <algorithm>

#include "smooth/heat.h"

namespace barycast {

uint64_t estimate_memory_bytes(const BindingSize& size, const ResolvedOptions& options) {
  const auto d = static_cast<uint64_t>(size.dimension);
  const uint64_t entry_bytes = 16 + d * sizeof(double);
  // Entries of a row: rarely more than 64 (more around polygons) at the usual thresholds, all at lower ones.
  const uint64_t entries =
      options.prune_below >= 1e-5 ? std::min(size.control_vertices, 64 + 2 * size.stencil_max) : size.control_vertices;
  // Workspaces, the block under way, and of every point: as it came, normalized, as a node, and its name's
  // place in a hash map. Vectors grow to twice what they hold.
  uint64_t bytes = (uint64_t{1} << 20) + size.threads * size.control_vertices * (d + 1) * sizeof(double) +
                   std::min(size.block_rows, size.points) * 4 * entries * entry_bytes +
                   size.points * (3 * d * sizeof(double) + 96) + 3 * size.face_corners * sizeof(uint32_t);
  if (options.denoise != Denoise::kMesh) return bytes;
  // A fit per vertex that a sample touches.
  const uint64_t fits = std::min(size.control_vertices, size.stencil_max * options.samples + 4);
  bytes += size.points * (512 + 2 * fits * (8 + (d + 1) * sizeof(double)) + 2 * entries * entry_bytes);
  // Edges and Laplacian while they are assembled, its factor (up to about 64 entries a point on surfaces), and
  // two blocks of columns per thread.
  return bytes + size.face_corners * 160 +
         size.points * (64 * 12 + 2 * size.threads * HeatKernel::kColumns * sizeof(double));
}

}  // namespace barycast
