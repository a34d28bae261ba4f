#include "estimate/moments.h"

#include <hwy/highway.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

static_assert(HWY_TARGET == HWY_AVX2, "Highway must compile for the baseline: HWY_DISABLE_PCLMUL_AES, x86-64-v3");

HWY_BEFORE_NAMESPACE();
namespace barycast {

namespace hn = hwy::HWY_NAMESPACE;
namespace {

constexpr hn::FixedTag<double, 4> kTag;
using Lanes = hn::Vec<hn::FixedTag<double, 4>>;

// [y; 1], in the plane and a zero.
template <int D>
HWY_INLINE Lanes homogeneous_lanes(const Vec<D>& y) {
  if constexpr (D == 3) {
    const auto three = hn::FirstN(kTag, 3);
    return hn::IfThenElse(three, hn::MaskedLoad(three, kTag, y.data()), hn::Set(kTag, 1.0));
  } else {
    alignas(32) const double values[4] = {y[0], y[1], 1.0, 0.0};
    return hn::Load(kTag, values);
  }
}

// The upper left corner of a matrix of lanes.
template <int N>
Mat<N> matrix_of(const Lanes (&column)[N]) {
  Eigen::Matrix<double, 4, N> result;
  for (int k = 0; k < N; ++k) hn::StoreU(column[k], kTag, result.col(k).data());
  return result.template topRows<N>();
}

// The frame of the samples.
template <int D>
void find_frame(std::span<const Sample<D>> samples, Moments<D>& out) {
  Lanes sum = hn::Zero(kTag);
  double weight_sum = 0.0;
  for (const Sample<D>& sample : samples) {
    const double magnitude = std::abs(sample.weight);
    sum = hn::MulAdd(hn::Set(kTag, magnitude), homogeneous_lanes<D>(sample.point), sum);
    weight_sum += magnitude;
  }
  alignas(32) double values[4];
  hn::Store(sum, kTag, values);
  out.centre = Eigen::Map<const Vec<D>>(values) / weight_sum;
  out.weight_mean = weight_sum / static_cast<double>(samples.size());

  const Lanes centre = homogeneous_lanes<D>(out.centre);
  Lanes squares = hn::Zero(kTag);
  for (const Sample<D>& sample : samples) {
    const Lanes off = hn::Sub(homogeneous_lanes<D>(sample.point), centre);
    squares = hn::MulAdd(hn::Mul(hn::Set(kTag, std::abs(sample.weight)), off), off, squares);
  }
  hn::Store(squares, kTag, values);
  const double spread = Eigen::Map<const Vec<D>>(values).sum();
  // Samples all at one point leave no spread to scale by; the frame's own unit does as well.
  out.scale = spread > 0.0 ? std::sqrt(weight_sum / spread) : 1.0;
}

}  // namespace

template <int D>
MomentAccumulator<D>::MomentAccumulator(const Cage<D>& cage)
    : cage_(cage),
      by_vertex_(cage.control_vertex_count(), Eigen::Vector4d::Zero()),
      touched_((cage.control_vertex_count() + 7) / 8 * 8) {}

template <int D>
void MomentAccumulator<D>::accumulate(std::span<const Sample<D>> samples, Weights weights, Moments<D>& out) {
  out.clear();
  out.sample_count = samples.size();
  if (samples.empty()) return;
  find_frame(samples, out);

  const Lanes centre = homogeneous_lanes<D>(out.centre), scale = hn::Set(kTag, out.scale);
  const Lanes constant = homogeneous_lanes<D>(Vec<D>::Zero());
  Lanes second[D + 1], negative[D + 1];
  for (int k = 0; k <= D; ++k) second[k] = negative[k] = hn::Zero(kTag);
  for (const Sample<D>& sample : samples) {
    const Lanes y = hn::MulAdd(hn::Sub(homogeneous_lanes<D>(sample.point), centre), scale, constant);
    const double weight = weights == Weights::kMagnitudes ? std::abs(sample.weight) : sample.weight;
    const Lanes weighted = hn::Mul(hn::Set(kTag, weight), y);
    // Without a branch, which nobody could predict.
    const Lanes if_negative = hn::Mul(hn::Set(kTag, std::min(weight, 0.0)), y);
    for (int k = 0; k < D; ++k) {
      const Lanes y_k = hn::Set(kTag, (sample.point[k] - out.centre[k]) * out.scale);
      second[k] = hn::MulAdd(y_k, weighted, second[k]);  // [SBC Eq. 9]
      negative[k] = hn::MulAdd(y_k, if_negative, negative[k]);
    }
    second[D] = hn::Add(second[D], weighted);
    negative[D] = hn::Add(negative[D], if_negative);

    cage_.for_each_basis(cage_.elements()[sample.element], sample.shares, 1.0, [&](uint32_t vertex, double phi) {
      touched_[vertex] = 1;
      double* const moment = by_vertex_[vertex].data();
      hn::StoreU(hn::MulAdd(hn::Set(kTag, phi), weighted, hn::LoadU(kTag, moment)), kTag, moment);  // [SBC Eq. 8]
    });
  }
  out.second = matrix_of<D + 1>(second);
  out.negative = matrix_of<D + 1>(negative);
  out.is_signed = out.negative(D, D) < 0.0;
  for (size_t begin = 0; begin < touched_.size(); begin += 8) {
    uint64_t eight;
    std::memcpy(&eight, touched_.data() + begin, 8);
    for (; eight != 0; eight &= eight - 1) {
      const size_t vertex = begin + static_cast<size_t>(std::countr_zero(eight)) / 8;
      out.first.push_back({static_cast<uint32_t>(vertex), by_vertex_[vertex].template head<D + 1>()});
      by_vertex_[vertex].setZero();
      touched_[vertex] = 0;
    }
  }
}

template class MomentAccumulator<2>;
template class MomentAccumulator<3>;

}  // namespace barycast
HWY_AFTER_NAMESPACE();
