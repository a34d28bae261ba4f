#include "smooth/smoother.h"

#include <algorithm>

#include "base/parallel.h"
#include "base/tolerances.h"

namespace barycast {
namespace {

constexpr size_t kColumns = HeatKernel::kColumns;
constexpr size_t kNodesPerPiece = 512;

// phi_v at the point an estimate is pinned to; 0 for all but the corners of its element.
double basis_value(std::span<const VertexWeight> basis, uint32_t vertex) {
  double value = 0.0;
  for (const VertexWeight& phi : basis)
    if (phi.vertex == vertex) value += phi.weight;
  return value;
}

template <int D>
void append_basis(const Cage<D>& cage, const CagePoint<D>& y, std::vector<VertexWeight>& basis) {
  cage.append_basis(cage.elements()[y.element], y.shares, 1.0, basis);
}

}  // namespace

template <int D>
Smoother<D>::Smoother(const Cage<D>& cage, const RowFinisher<D>& finisher, const HeatKernel& kernel, NodeFits<D>& fits)
    : cage_(cage), finisher_(finisher), kernel_(kernel), fits_(fits), rows_(fits.group_count()) {
  static_assert(kNodesPerPiece * NodeFits<D>::kGroupVertices <= UINT16_MAX);
}

// On the cage values are packed less the basis, which would lose digits.
template <int D>
void Smoother<D>::collect(size_t node, std::span<const uint32_t> vertices, const float* columns,
                          PackedRows<D>& rows) const {
  constexpr size_t kHomogeneous = NodeFits<D>::kHomogeneous;
  const NodeState<D>& state = fits_.state(node);
  const Vec<D>& x = fits_.positions()[node];
  const Vec<D + 1> at = homogeneous<D>(x);
  thread_local std::vector<VertexWeight> basis;
  basis.clear();
  if (state.on_cage) append_basis(cage_, *state.on_cage, basis);
  for (size_t k = 0; k < vertices.size(); ++k) {
    const Vec<D + 1> pseudo = state.pseudo * homogeneous<D>(cage_.control_vertices()[vertices[k]]);
    const Vec<D + 1> u =
        pseudo + Eigen::Map<const Eigen::Matrix<float, D + 1, 1>>(columns + k * kHomogeneous).template cast<double>();
    const Vec<D> gradient = u.template head<D>();
    const double phi = basis_value(basis, vertices[k]);
    const double value = state.on_cage ? gradient.dot(x - state.on_cage->point) : u.dot(at);
    const double gradient_norm = finisher_.gradients() ? gradient.norm() : 0.0;
    if (finisher_.is_kept(std::abs(value + phi), gradient_norm, kCollectBelowPrune) && (phi != 0.0 || !u.isZero(0.0)))
      rows.add(k, value, gradient);
  }
}

template <int D>
bool Smoother<D>::smooth_pseudo(const std::atomic<bool>& cancel) {
  blocks_.resize(1);
  blocks_[0].resize(fits_.positions().size() * kColumns);
  if (fits_.copy_pseudo(kernel_, blocks_[0])) {
    if (!kernel_.smooth(blocks_[0], cancel)) return false;
    fits_.set_pseudo(kernel_, blocks_[0]);
  }
  return true;
}

template <int D>
bool Smoother<D>::advance(const std::atomic<bool>& cancel) {
  if (groups_done_ == 0) {
    if (!smooth_pseudo(cancel)) return false;
    groups_done_ = 1;
    return true;
  }
  const size_t nodes = fits_.positions().size(), first = groups_done_ - 1;
  const size_t in_memory = std::max<size_t>(1, kBlocksBytesMax / (nodes * kColumns * sizeof(float)));
  const size_t count = std::min({parallel_width(), in_memory, group_count() - groups_done_});
  blocks_.resize(std::max(blocks_.size(), count));
  std::atomic<bool> complete = true;
  parallel_for(count, 1, [&](size_t begin, size_t end) {
    for (size_t g = begin; g < end; ++g) {
      blocks_[g].resize(nodes * kColumns);
      if (fits_.take(first + g, kernel_, blocks_[g]) && !kernel_.smooth(blocks_[g], cancel)) complete = false;
    }
  });
  if (!complete) return false;
  const size_t pieces = (nodes + kNodesPerPiece - 1) / kNodesPerPiece;
  for (size_t g = 0; g < count; ++g) rows_[first + g].assign(pieces, PackedRows<D>(finisher_.gradients()));
  parallel_for(pieces * count, 1, [&](size_t begin, size_t end) {
    PackedRows<D> rows(finisher_.gradients());
    for (size_t i = begin; i < end; ++i) {
      const size_t g = i / pieces, piece = i % pieces;
      rows.clear();
      for (size_t node = piece * kNodesPerPiece; node < std::min(nodes, (piece + 1) * kNodesPerPiece); ++node) {
        if (kernel_.smooths(node))
          collect(node, fits_.group_vertices(first + g), blocks_[g].data() + kernel_.place(node) * kColumns, rows);
        rows.end_node();
      }
      rows_[first + g][piece] = rows;  // a copy, without slack
    }
  });
  groups_done_ += count;
  if (groups_done_ == group_count()) blocks_ = {};
  return true;
}

template <int D>
void Smoother<D>::row(size_t node, std::vector<RowEntry<D>>& row) const {
  row.clear();
  for (size_t g = 0; g < rows_.size(); ++g)
    rows_[g][node / kNodesPerPiece].append_to(row, node % kNodesPerPiece, fits_.group_vertices(g));
  const auto& on_cage = fits_.state(node).on_cage;
  if (!on_cage) return;
  std::vector<VertexWeight> basis;
  append_basis(cage_, *on_cage, basis);
  for (RowEntry<D>& entry : row) entry.value += basis_value(basis, entry.vertex);
}

template class Smoother<2>;
template class Smoother<3>;

}  // namespace barycast
