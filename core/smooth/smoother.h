#pragma once

// Denoising of linear fits over a query mesh [SBC Eq. 11]: every u_v is smoothed by the heat kernel in
// the cage's common frame, a group of control vertices at a time, so that memory stays at a few columns
// and the rows that survive. On the cage only gradients move; the constant is set so that the row stays
// the basis there [SBC 4.4]. Linear precision holds because every column sees the same operator.

#include <atomic>
#include <vector>

#include "estimate/row.h"
#include "smooth/heat.h"
#include "smooth/node_fits.h"
#include "smooth/packed_rows.h"

namespace barycast {

template <int D>
class Smoother {
 public:
  // fits: of the nodes, used up. All borrowed.
  Smoother(const Cage<D>& cage, const RowFinisher<D>& finisher, const HeatKernel& kernel, NodeFits<D>& fits);

  // The first group is that of the pseudo-samples.
  size_t group_count() const { return 1 + fits_.group_count(); }
  size_t groups_done() const { return groups_done_; }

  // Smooths the next groups, one per thread of the arena while memory allows. False: `cancel` was seen set.
  bool advance(const std::atomic<bool>& cancel);

  // After all groups: the entries of a node that takes part which may survive pruning, ascending by vertex, evaluated
  // at the node.
  void row(size_t node, std::vector<RowEntry<D>>& row) const;

  // Of the blocks of columns under way, unless a single one is larger.
  static constexpr size_t kBlocksBytesMax = size_t{1} << 30;

 private:
  bool smooth_pseudo(const std::atomic<bool>& cancel);
  void collect(size_t node, std::span<const uint32_t> vertices, const float* columns, PackedRows<D>& rows) const;

  const Cage<D>& cage_;
  const RowFinisher<D>& finisher_;
  const HeatKernel& kernel_;
  NodeFits<D>& fits_;
  size_t groups_done_ = 0;
  std::vector<std::vector<PackedRows<D>>> rows_;  // by group of vertices, then by kNodesPerPiece nodes
  std::vector<std::vector<float>> blocks_;
};

extern template class Smoother<2>;
extern template class Smoother<3>;

}  // namespace barycast
