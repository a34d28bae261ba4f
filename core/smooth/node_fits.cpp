#include "smooth/node_fits.h"

#include <algorithm>

namespace barycast {
namespace {

constexpr size_t kColumns = HeatKernel::kColumns;

template <int D>
using PseudoBlock = Eigen::Matrix<float, D + 1, D + 1>;

}  // namespace

template <int D>
NodeFits<D>::NodeFits(const Cage<D>& cage, std::span<const Vec<D>> positions)
    : cage_(cage),
      positions_(positions),
      rank_(cage.control_vertex_count(), 0),
      states_(positions.size()),
      chunks_((cage.used_vertices().size() + kGroupVertices - 1) / kGroupVertices) {
  static_assert(kHomogeneous * kHomogeneous <= kColumns, "the pseudo-samples' matrix is one block");
  uint32_t next = 0;
  for (const uint32_t v : cage.used_vertices()) rank_[v] = next++;
}

template <int D>
std::span<const uint32_t> NodeFits<D>::group_vertices(size_t group) const {
  const auto used = cage_.used_vertices();
  const size_t begin = group * kGroupVertices;
  return used.subspan(begin, std::min(kGroupVertices, used.size() - begin));
}

template <int D>
void NodeFits<D>::add(std::span<const uint32_t> nodes, std::span<const PointEstimate<D>> estimates) {
  if (nodes.empty()) return;
  std::vector<uint32_t> length(chunks_.size(), 0);
  for (const PointEstimate<D>& estimate : estimates)
    for (const LinearFit<D>& fit : estimate.projected.fits) ++length[rank_[fit.vertex] / kGroupVertices];
  std::vector<Chunk> chunks(chunks_.size());
  for (size_t group = 0; group < chunks.size(); ++group) {
    chunks[group].first_node = nodes.front();
    chunks[group].fits.reserve(length[group]);
  }
  SampleCounts counts;
  for (size_t i = 0; i < nodes.size(); ++i) {
    const PointEstimate<D>& estimate = estimates[i];
    states_[nodes[i]] = {estimate.projected.pseudo, estimate.on_cage, estimate.distance, estimate.flags};
    counts += estimate.counts;
    const Vec<D + 1> at = homogeneous<D>(positions_[nodes[i]]);
    for (const LinearFit<D>& fit : estimate.projected.fits) {
      const uint32_t rank = rank_[fit.vertex];
      Fit stored{static_cast<uint16_t>(nodes[i] - nodes.front()), static_cast<uint16_t>(rank % kGroupVertices), {}};
      for (int k = 0; k < D; ++k) stored.u[static_cast<size_t>(k)] = static_cast<float>(fit.u[k]);
      stored.u[D] = static_cast<float>(fit.u.dot(at));
      chunks[rank / kGroupVertices].fits.push_back(stored);
    }
  }
  const std::scoped_lock lock(mutex_);
  counts_ += counts;
  for (size_t group = 0; group < chunks.size(); ++group)
    if (!chunks[group].fits.empty()) chunks_[group].push_back(std::move(chunks[group]));
}

template <int D>
bool NodeFits<D>::take(size_t group, const HeatKernel& kernel, std::span<float> block) {
  const std::vector<Chunk> chunks = std::move(chunks_[group]);
  std::fill(block.begin(), block.end(), 0.0f);
  for (const Chunk& chunk : chunks)
    for (const Fit& fit : chunk.fits) {
      const uint32_t node = chunk.first_node + fit.node;
      float* const u = block.data() + kernel.place(node) * kColumns + fit.place * kHomogeneous;
      double constant = double{fit.u[D]};
      for (int k = 0; k < D; ++k) {
        u[k] = fit.u[static_cast<size_t>(k)];
        constant -= double{u[k]} * positions_[node][k];
      }
      u[D] = static_cast<float>(constant);
    }
  return !chunks.empty();
}

template <int D>
bool NodeFits<D>::copy_pseudo(const HeatKernel& kernel, std::span<float> block) const {
  std::fill(block.begin(), block.end(), 0.0f);
  bool any = false;
  for (size_t node = 0; node < states_.size(); ++node) {
    const Mat<D + 1>& pseudo = states_[node].pseudo;
    any = any || !pseudo.isZero(0.0);
    Eigen::Map<PseudoBlock<D>>(block.data() + kernel.place(node) * kColumns) = pseudo.template cast<float>();
  }
  return any;
}

template <int D>
void NodeFits<D>::set_pseudo(const HeatKernel& kernel, std::span<const float> block) {
  for (size_t node = 0; node < states_.size(); ++node) {
    Mat<D + 1>& pseudo = states_[node].pseudo;
    pseudo = Eigen::Map<const PseudoBlock<D>>(block.data() + kernel.place(node) * kColumns).template cast<double>();
    if (const auto& y = states_[node].on_cage) pseudo.row(D) = -y->point.transpose() * pseudo.template topRows<D>();
  }
}

template class NodeFits<2>;
template class NodeFits<3>;

}  // namespace barycast
