#pragma once

// Denoising of linear fits over a query mesh [SBC Eq. 11]: every u_v is smoothed by the heat kernel in
// the cage's common frame, a group of control vertices at a time, so that memory stays at a few columns
// and the rows that survive. On the cage only gradients move; the constant is set so that the row stays
// the basis there [SBC 4.4]. Linear precision holds because every column sees the same operator.

#include <atomic>
#include <vector>

#include "estimate/point_estimator.h"
#include "estimate/row.h"
#include "smooth/heat.h"

namespace barycast {

template <int D>
class Smoother {
 public:
  // nodes: positions in the normalized frame; estimates: of the nodes, in their order. All borrowed.
  Smoother(const Cage<D>& cage, const RowFinisher<D>& finisher, const HeatKernel& kernel, std::span<const Vec<D>> nodes,
           std::span<const PointEstimate<D>> estimates);

  // The first group is that of the pseudo-samples.
  size_t group_count() const { return 1 + vertex_group_count_; }
  size_t groups_done() const { return groups_done_; }

  // Smooths the next groups, one per thread of the arena. False: `cancel` was seen set.
  bool advance(const std::atomic<bool>& cancel);

  // After all groups: the entries of a node that may survive pruning, ascending by vertex, evaluated at
  // the node.
  const std::vector<RowEntry<D>>& row(size_t node) const { return rows_[node]; }

 private:
  static constexpr size_t kHomogeneous = D + 1;
  static constexpr size_t kGroupVertices = HeatKernel::kColumns / kHomogeneous;

  std::span<const uint32_t> group_vertices(size_t group) const;
  bool gather(size_t group, std::vector<float>& block) const;
  void take_pseudo(const std::vector<float>& block);
  void collect(size_t node, std::span<const uint32_t> vertices, const float* columns);

  const Cage<D>& cage_;
  const RowFinisher<D>& finisher_;
  const HeatKernel& kernel_;
  std::span<const Vec<D>> nodes_;
  std::span<const PointEstimate<D>> estimates_;
  size_t vertex_group_count_;
  size_t groups_done_ = 0;
  std::vector<Mat<D + 1>> pseudo_;  // smoothed, by node
  std::vector<std::vector<RowEntry<D>>> rows_;
  struct Workspace {
    std::vector<float> block, solve;
    bool any = false;  // some column of the block is not zero
  };
  std::vector<Workspace> workspaces_;
};

extern template class Smoother<2>;
extern template class Smoother<3>;

}  // namespace barycast
