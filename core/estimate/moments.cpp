#include "estimate/moments.h"

#include <bit>
#include <cmath>
#include <utility>

namespace barycast {

template <int D>
MomentAccumulator<D>::MomentAccumulator(const Cage<D>& cage)
    : cage_(cage),
      by_vertex_(cage.control_vertex_count(), Vec<D + 1>::Zero()),
      touched_((cage.control_vertex_count() + 63) / 64) {}

template <int D>
void MomentAccumulator<D>::accumulate(std::span<const Sample<D>> samples, Weights weights, Moments<D>& out) {
  out.clear();
  out.sample_count = samples.size();
  if (samples.empty()) return;

  double weight_sum = 0.0;
  for (const Sample<D>& sample : samples) {
    out.centre += std::abs(sample.weight) * sample.point;
    weight_sum += std::abs(sample.weight);
  }
  out.centre /= weight_sum;
  out.weight_mean = weight_sum / static_cast<double>(samples.size());
  double spread = 0.0;
  for (const Sample<D>& sample : samples) spread += std::abs(sample.weight) * (sample.point - out.centre).squaredNorm();
  // Samples all at one point leave no spread to scale by; the frame's own unit does as well.
  out.scale = spread > 0.0 ? std::sqrt(weight_sum / spread) : 1.0;

  for (const Sample<D>& sample : samples) {
    const Vec<D + 1> y = homogeneous<D>((sample.point - out.centre) * out.scale);
    const double weight = weights == Weights::kMagnitudes ? std::abs(sample.weight) : sample.weight;
    const Vec<D + 1> weighted = weight * y;
    out.second += weighted * y.transpose();  // [SBC Eq. 9]
    if (weight < 0) {
      out.is_signed = true;
      out.negative += weighted * y.transpose();
    }
    basis_.clear();
    cage_.append_basis(cage_.elements()[sample.element], sample.shares, 1.0, basis_);
    for (const VertexWeight& phi : basis_) {
      touched_[phi.vertex / 64] |= uint64_t{1} << (phi.vertex % 64);
      by_vertex_[phi.vertex] += phi.weight * weighted;  // [SBC Eq. 8]
    }
  }
  for (size_t word = 0; word < touched_.size(); ++word)
    for (uint64_t bits = std::exchange(touched_[word], 0); bits != 0; bits &= bits - 1) {
      const auto vertex = static_cast<uint32_t>(64 * word) + static_cast<uint32_t>(std::countr_zero(bits));
      out.first.push_back({vertex, by_vertex_[vertex]});
      by_vertex_[vertex].setZero();
    }
}

template class MomentAccumulator<2>;
template class MomentAccumulator<3>;

}  // namespace barycast
