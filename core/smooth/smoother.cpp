#include "smooth/smoother.h"

#include <algorithm>

#include "base/parallel.h"
#include "base/tolerances.h"

namespace barycast {
namespace {

constexpr size_t kColumns = HeatKernel::kColumns;
constexpr size_t kNodesPerTask = 512;

// phi_v at the point an estimate is pinned to; 0 for all but the corners of its element.
double basis_value(std::span<const VertexWeight> basis, uint32_t vertex) {
  double value = 0.0;
  for (const VertexWeight& phi : basis)
    if (phi.vertex == vertex) value += phi.weight;
  return value;
}

}  // namespace

template <int D>
Smoother<D>::Smoother(const Cage<D>& cage, const RowFinisher<D>& finisher, const HeatKernel& kernel,
                      std::span<const Vec<D>> nodes, std::span<const PointEstimate<D>> estimates)
    : cage_(cage),
      finisher_(finisher),
      kernel_(kernel),
      nodes_(nodes),
      estimates_(estimates),
      vertex_group_count_((cage.used_vertices().size() + kGroupVertices - 1) / kGroupVertices),
      pseudo_(nodes.size()),
      rows_(nodes.size()) {
  static_assert(kHomogeneous * kHomogeneous <= kColumns, "the pseudo-samples' matrix is one block");
  // Nodes that take no part keep their rows, in double.
  for (size_t node = 0; node < nodes.size(); ++node)
    if (!kernel.smooths(node)) finisher.evaluate(estimates[node].projected, nodes[node], rows_[node]);
}

template <int D>
std::span<const uint32_t> Smoother<D>::group_vertices(size_t group) const {
  const auto used = cage_.used_vertices();
  const size_t begin = (group - 1) * kGroupVertices;
  return used.subspan(begin, std::min(kGroupVertices, used.size() - begin));
}

// Copies the fits of a group of vertices into a block; says whether there were any.
template <int D>
bool Smoother<D>::gather(size_t group, std::vector<float>& block) const {
  block.assign(nodes_.size() * kColumns, 0.0f);
  if (group == 0) {
    for (size_t node = 0; node < nodes_.size(); ++node)
      Eigen::Map<Eigen::Matrix<float, D + 1, D + 1>>(block.data() + node * kColumns) =
          estimates_[node].projected.pseudo.template cast<float>();
    return true;
  }
  const std::span<const uint32_t> vertices = group_vertices(group);
  bool any = false;
  for (size_t node = 0; node < nodes_.size(); ++node) {
    const auto& fits = estimates_[node].projected.fits;
    auto fit = std::lower_bound(fits.begin(), fits.end(), vertices.front(),
                                [](const LinearFit<D>& f, uint32_t vertex) { return f.vertex < vertex; });
    for (size_t k = 0; k < vertices.size() && fit != fits.end(); ++k) {
      if (fit->vertex != vertices[k]) continue;
      for (size_t i = 0; i < kHomogeneous; ++i)
        block[node * kColumns + k * kHomogeneous + i] = static_cast<float>(fit->u[static_cast<Eigen::Index>(i)]);
      any = true;
      ++fit;
    }
  }
  return any;
}

template <int D>
void Smoother<D>::take_pseudo(const std::vector<float>& block) {
  for (size_t node = 0; node < nodes_.size(); ++node) {
    pseudo_[node] =
        Eigen::Map<const Eigen::Matrix<float, D + 1, D + 1>>(block.data() + node * kColumns).template cast<double>();
    if (const auto& y = estimates_[node].on_cage)
      pseudo_[node].row(D) = -y->point.transpose() * pseudo_[node].template topRows<D>();
  }
}

template <int D>
void Smoother<D>::collect(size_t node, std::span<const uint32_t> vertices, const float* columns) {
  const Vec<D + 1> at = homogeneous<D>(nodes_[node]);
  const auto& on_cage = estimates_[node].on_cage;
  thread_local std::vector<VertexWeight> basis;
  basis.clear();
  if (on_cage) cage_.append_basis(cage_.elements()[on_cage->element], on_cage->shares, 1.0, basis);
  for (size_t k = 0; k < vertices.size(); ++k) {
    Vec<D + 1> u = Eigen::Map<const Eigen::Matrix<float, D + 1, 1>>(columns + k * kHomogeneous).template cast<double>();
    // The pseudo-samples' constants are already set for points on the cage.
    if (on_cage) u[D] = basis_value(basis, vertices[k]) - u.template head<D>().dot(on_cage->point);
    u += pseudo_[node] * homogeneous<D>(cage_.control_vertices()[vertices[k]]);
    const double value = u.dot(at);
    const Vec<D> gradient = u.template head<D>();
    if (finisher_.is_kept(std::abs(value), gradient.norm(), kCollectBelowPrune) && !u.isZero(0.0))
      rows_[node].push_back({vertices[k], value, gradient});
  }
}

template <int D>
bool Smoother<D>::advance(const std::atomic<bool>& cancel) {
  const size_t first = groups_done_, count = std::min(parallel_width(), group_count() - first);
  workspaces_.resize(std::max(workspaces_.size(), count));
  std::atomic<bool> complete = true;
  parallel_for(count, 1, [&](size_t begin, size_t end) {
    for (size_t g = begin; g < end; ++g) {
      Workspace& workspace = workspaces_[g];
      workspace.any = gather(first + g, workspace.block);
      if (workspace.any && !kernel_.smooth(workspace.block, workspace.solve, cancel)) complete = false;
    }
  });
  if (!complete) return false;
  if (first == 0) take_pseudo(workspaces_[0].block);
  parallel_for(nodes_.size(), kNodesPerTask, [&](size_t begin, size_t end) {
    for (size_t node = begin; node < end; ++node)
      for (size_t g = first == 0 ? 1 : 0; g < count && kernel_.smooths(node); ++g)
        collect(node, group_vertices(first + g), workspaces_[g].block.data() + node * kColumns);
  });
  groups_done_ += count;
  return true;
}

template class Smoother<2>;
template class Smoother<3>;

}  // namespace barycast
