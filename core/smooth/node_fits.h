#pragma once

// The linear fits of a query mesh's nodes, as denoising needs them: in floats, whose rounding is far below their noise,
// and by groups of control vertices, as many as one solve of the heat kernel takes. A group is freed as it is read,
// while the smoothed rows grow, so that both are never held whole.

#include <array>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

#include "estimate/point_estimator.h"
#include "smooth/heat.h"

namespace barycast {

// What is kept of a node besides its fits.
template <int D>
struct NodeState {
  Mat<D + 1> pseudo = Mat<D + 1>::Zero();
  std::optional<CagePoint<D>> on_cage;
  double distance = 0.0;  // to the cage
  uint8_t flags = 0;      // RowFlags
};

template <int D>
class NodeFits {
 public:
  static constexpr size_t kHomogeneous = D + 1;
  static constexpr size_t kGroupVertices = HeatKernel::kColumns / kHomogeneous;

  // positions: of the nodes, in the normalized frame. All borrowed.
  NodeFits(const Cage<D>& cage, std::span<const Vec<D>> positions);

  // Takes the estimates of some nodes, ascending, of any 65,536 in a row; each node once. Thread-safe.
  void add(std::span<const uint32_t> nodes, std::span<const PointEstimate<D>> estimates);

  std::span<const Vec<D>> positions() const { return positions_; }
  const NodeState<D>& state(size_t node) const { return states_[node]; }
  const SampleCounts& counts() const { return counts_; }  // of all that were added

  // Groups of the used control vertices, in their order; the last may have fewer.
  size_t group_count() const { return chunks_.size(); }
  std::span<const uint32_t> group_vertices(size_t group) const;

  // Fills a block of the kernel (zero where nothing is) with the fits of a group, vertex after vertex, and frees them;
  // says whether there were any. Thread-safe for different groups.
  bool take(size_t group, const HeatKernel& kernel, std::span<float> block);

  // The same for the matrices of the pseudo-samples, which stay until they are set from a smoothed block.
  bool copy_pseudo(const HeatKernel& kernel, std::span<float> block) const;
  void set_pseudo(const HeatKernel& kernel, std::span<const float> block);

 private:
  struct Fit {
    uint16_t node;   // from the chunk's first
    uint16_t place;  // of the vertex in its group
    // Gradient, and the value at the node: far from the cage the constant would be rounded more.
    std::array<float, D + 1> u;
  };
  struct Chunk {
    uint32_t first_node;
    std::vector<Fit> fits;  // by node
  };

 public:
  static constexpr size_t kFitBytes = sizeof(Fit), kListBytes = sizeof(Chunk);  // of memory estimates

 private:
  const Cage<D>& cage_;
  std::span<const Vec<D>> positions_;
  std::vector<uint32_t> rank_;  // of a used control vertex among them
  std::vector<NodeState<D>> states_;
  std::mutex mutex_;                        // of the two below, while estimates are added
  std::vector<std::vector<Chunk>> chunks_;  // by group, in no particular order: each fit has a place of its own
  SampleCounts counts_;
};

extern template class NodeFits<2>;
extern template class NodeFits<3>;

}  // namespace barycast
