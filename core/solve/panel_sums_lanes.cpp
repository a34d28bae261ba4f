#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "solve/panel_sums_lanes.cpp"  // this file, once for every processor
#include "solve/panel_sums_lanes.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <hwy/contrib/math/math-inl.h>

#include <algorithm>
#include <numbers>

HWY_BEFORE_NAMESPACE();
namespace barycast::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using Tag = hn::CappedTag<float, kSumLanes>;
using Floats = hn::Vec<Tag>;
constexpr Tag kTag;
constexpr size_t kWidth = hn::MaxLanes(kTag);
// Half a vector of floats is one of doubles.
using HalfTag = hn::Half<Tag>;
using DoubleTag = hn::Rebind<double, HalfTag>;
constexpr HalfTag kHalfTag;
constexpr DoubleTag kDoubleTag;

template <class V>
struct Lanes3 {
  V x, y, z;
};
template <class D, class T>
HWY_INLINE Lanes3<hn::Vec<D>> all(D d, const std::array<T, 3>& v) {
  return {hn::Set(d, v[0]), hn::Set(d, v[1]), hn::Set(d, v[2])};
}
template <class V>
HWY_INLINE Lanes3<V> operator-(const Lanes3<V>& a, const Lanes3<V>& b) {
  return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)};
}
template <class V>
HWY_INLINE Lanes3<V> operator*(const Lanes3<V>& a, V s) {
  return {hn::Mul(a.x, s), hn::Mul(a.y, s), hn::Mul(a.z, s)};
}
template <class V>
HWY_INLINE V dot(const Lanes3<V>& a, const Lanes3<V>& b) {
  return hn::MulAdd(a.x, b.x, hn::MulAdd(a.y, b.y, hn::Mul(a.z, b.z)));
}
// b + a s, b - a s
template <class V>
HWY_INLINE Lanes3<V> mul_add(const Lanes3<V>& a, V s, const Lanes3<V>& b) {
  return {hn::MulAdd(a.x, s, b.x), hn::MulAdd(a.y, s, b.y), hn::MulAdd(a.z, s, b.z)};
}
template <class V>
HWY_INLINE Lanes3<V> mul_sub(const Lanes3<V>& a, V s, const Lanes3<V>& b) {
  return {hn::NegMulAdd(a.x, s, b.x), hn::NegMulAdd(a.y, s, b.y), hn::NegMulAdd(a.z, s, b.z)};
}

// What a point makes of a panel, see panel_potential.h: by row (potential, then its gradient) and density function.
template <bool kGradients, class V>
struct Kernels {
  static constexpr size_t kRows = kGradients ? 4 : 1;
  V charge[kRows][3], dipole[kRows][3];

  HWY_INLINE void set_gradient(V (&table)[kRows][3], size_t k, const Lanes3<V>& gradient) {
    table[1][k] = gradient.x;
    table[2][k] = gradient.y;
    table[3][k] = gradient.z;
  }
};

template <bool kGradients>
using FloatKernels = Kernels<kGradients, Floats>;

// Where the mask is set, those of `near`.
template <bool kGradients>
HWY_INLINE void replace(hn::Mask<Tag> mask, const FloatKernels<kGradients>& near, FloatKernels<kGradients>& out) {
  for (size_t r = 0; r < out.kRows; ++r)
    for (size_t k = 0; k < 3; ++k) {
      out.charge[r][k] = hn::IfThenElse(mask, near.charge[r][k], out.charge[r][k]);
      out.dipole[r][k] = hn::IfThenElse(mask, near.dipole[r][k], out.dipole[r][k]);
    }
}

// `x`: from the panel's centre.
template <bool kGradients>
HWY_INLINE void three_points(const SumPoints& panel, const Lanes3<Floats>& x, FloatKernels<kGradients>& out) {
  const Lanes3<Floats> normal = all(kTag, panel.normal);
  const Floats height = dot(normal, x);
  for (size_t k = 0; k < 3; ++k) {
    const Lanes3<Floats> to = all(kTag, panel.point[k]) - x;
    const Floats squared = dot(to, to), inverse_squared = hn::Div(hn::Set(kTag, 1.0f), squared);
    out.charge[0][k] = hn::Mul(hn::Set(kTag, panel.charge), hn::Sqrt(inverse_squared));
    const Floats rate = hn::Mul(out.charge[0][k], inverse_squared);
    out.dipole[0][k] = hn::Mul(height, rate);
    if constexpr (kGradients) {
      const Floats along = hn::Mul(hn::Mul(hn::Set(kTag, 3.0f), height), inverse_squared);
      out.set_gradient(out.charge, k, to * rate);
      out.set_gradient(out.dipole, k, mul_add(to, along, normal) * rate);
    }
  }
}

template <bool kGradients>
HWY_NOINLINE void seven_points(const SumPoints& panel, const Lanes3<Floats>& x, FloatKernels<kGradients>& out) {
  const Lanes3<Floats> normal = all(kTag, panel.normal);
  const Floats height = dot(normal, x), zero = hn::Zero(kTag);
  Floats value[3] = {zero, zero, zero}, rate[3] = {zero, zero, zero};
  Lanes3<Floats> to_rates[3], direction_rates[3];
  std::fill_n(to_rates, 3, Lanes3<Floats>{zero, zero, zero});
  std::fill_n(direction_rates, 3, Lanes3<Floats>{zero, zero, zero});
  for (size_t j = 0; j < 7; ++j) {
    const Lanes3<Floats> to = all(kTag, panel.rule[j]) - x;
    const Floats inverse_squared = hn::Div(hn::Set(kTag, 1.0f), dot(to, to)), inverse = hn::Sqrt(inverse_squared);
    const Floats cube = hn::Mul(inverse, inverse_squared);
    const Lanes3<Floats> to_cube = to * cube;
    const Lanes3<Floats> direction =
        mul_add(to_cube, hn::Mul(hn::Mul(hn::Set(kTag, 3.0f), height), inverse_squared), normal * cube);
    for (size_t k = 0; k < 3; ++k) {
      const Floats charge = hn::Set(kTag, panel.rule_charge[j][k]);
      value[k] = hn::MulAdd(charge, inverse, value[k]);
      rate[k] = hn::MulAdd(charge, cube, rate[k]);
      if constexpr (kGradients) {
        to_rates[k] = mul_add(to_cube, charge, to_rates[k]);
        direction_rates[k] = mul_add(direction, charge, direction_rates[k]);
      }
    }
  }
  for (size_t k = 0; k < 3; ++k) {
    out.charge[0][k] = value[k];
    out.dipole[0][k] = hn::Mul(height, rate[k]);
    if constexpr (kGradients) {
      out.set_gradient(out.charge, k, to_rates[k]);
      out.set_gradient(out.dipole, k, direction_rates[k]);
    }
  }
}

// atan2(y, x) of y >= 0.
template <class D, class V, class T = hn::TFromD<D>>
HWY_INLINE V angle_of(D d, V y, V x) {
  const V size = hn::Abs(x), least = hn::Min(y, size), most = hn::Max(y, size);
  // hn::Atan would divide once more to reduce its argument.
  const V ratio = hn::Div(least, hn::Max(most, hn::Set(d, T(1e-35))));
  const V part = hn::impl::AtanImpl<T>().AtanPoly(d, ratio);
  const V acute = hn::IfThenElse(hn::Gt(y, size), hn::Sub(hn::Set(d, T(std::numbers::pi / 2)), part), part);
  return hn::IfThenElse(hn::Lt(x, hn::Zero(d)), hn::Sub(hn::Set(d, T(std::numbers::pi)), acute), acute);
}

// ln((sum + length) / (sum - length)) = 2 artanh(length / sum), relative error 2e-7 up to artanh = 2.1, and 1 / sum.
// By the series, after a step or two along artanh: artanh(y) - artanh(t) = artanh((y - t) / (1 - y t)). One division.
HWY_INLINE Floats log_of_sides(Floats length, Floats sum, Floats& reciprocal) {
  const auto set = [](double value) HWY_ATTR { return hn::Set(kTag, static_cast<float>(value)); };
  constexpr double kTanh1 = 0.39693043200507, kTanh2 = 0.68580906222909, kTanh3 = 0.85106410966794,
                   kTanh4 = 0.93286155343703;  // of 0.42 k
  const auto step = hn::Gt(length, hn::Mul(set(kTanh1), sum)), two_steps = hn::Gt(length, hn::Mul(set(kTanh3), sum));
  const Floats back = hn::IfThenElse(two_steps, set(kTanh4), hn::IfThenElseZero(step, set(kTanh2)));
  const Floats stepped = hn::IfThenElse(two_steps, set(8 * 0.42), hn::IfThenElseZero(step, set(4 * 0.42)));
  const Floats above = hn::NegMulAdd(back, sum, length), below = hn::NegMulAdd(back, length, sum);
  const Floats inverse = hn::Div(set(1.0), hn::Mul(sum, below));
  reciprocal = hn::Mul(inverse, below);
  const Floats z = hn::Mul(hn::Mul(above, sum), inverse), squared = hn::Mul(z, z);
  Floats series = set(2.0 / 15);
  for (int k = 13; k >= 1; k -= 2) series = hn::MulAdd(series, squared, set(2.0 / k));
  return hn::MulAdd(series, z, stepped);
}

// Keep quotients on an edge finite, in floats as well: squared lengths in diagonals, below those of points a billionth
// off it, where potentials are still asked for.
constexpr double kNearestSquared = 1e-20;
// In diagonals. Closer than this to a panel's plane is on it: that is what rounding leaves of points there.
constexpr double kOnPlane = 1e-13;

// Integrals along an edge, with the names of panel_potential.cpp.
template <class V>
struct Edge {
  V distance, inverse, first, radial, cube;
  V product;  // of the vectors to its ends
  V turn;     // 1 / near - 1 / far
};

// With q = near far + product,
//   int dl / R = ln(1 + length (near + far + length) / q),  int dl / R^3 = length (near + far) / (near far q).
// In doubles the point may be next to the edge, or on it.
template <bool kGradients, class D, class V, class T = hn::TFromD<D>>
HWY_INLINE Edge<V> edge_integrals(D d, const SumTriangle<T>& panel, size_t e, const Lanes3<V>& x, V height, V near,
                                  V far) {
  const auto set = [&](double value) HWY_ATTR { return hn::Set(d, static_cast<T>(value)); };
  Edge<V> edge;
  const V length = hn::Set(d, panel.length[e]);
  const V start = hn::Sub(hn::Set(d, panel.start[e]), dot(all(d, panel.along[e]), x)), end = hn::Add(start, length);
  edge.distance = hn::Sub(hn::Set(d, panel.distance[e]), dot(all(d, panel.outward[e]), x));
  const V line_squared = hn::MulAdd(edge.distance, edge.distance, hn::Mul(height, height));
  edge.product = hn::MulAdd(start, end, line_squared);
  const V both = hn::Mul(near, far), sum = hn::Add(near, far);
  V q = hn::Add(both, edge.product), reciprocal;  // of the sum
  if constexpr (sizeof(T) == sizeof(double)) {
    // Beside the edge q would cancel; times the difference of the same two it is the square of their cross product.
    const V beside = hn::Div(hn::Mul(hn::Mul(length, length), line_squared), hn::Sub(both, edge.product));
    q = hn::Max(hn::IfThenElse(hn::Lt(edge.product, hn::Zero(d)), beside, q), set(kNearestSquared));
    edge.inverse = hn::Log1p(d, hn::Div(hn::Mul(length, hn::Add(sum, length)), q));
    reciprocal = hn::Div(set(1.0), sum);
  } else {
    edge.inverse = log_of_sides(length, sum, reciprocal);
  }
  const V middle = hn::Add(start, end);
  edge.first = hn::Mul(hn::Mul(length, middle), reciprocal);             // far - near
  const V twice = hn::MulAdd(edge.first, middle, hn::Mul(length, sum));  // end far - start near, without cancellation
  edge.radial = hn::MulAdd(hn::Mul(set(0.5), line_squared), edge.inverse, hn::Mul(set(0.25), twice));
  if constexpr (kGradients) {
    const V inverse_both = hn::Div(set(1.0), both);
    edge.turn = hn::Mul(edge.first, inverse_both);
    edge.cube = hn::Mul(hn::Div(hn::Mul(length, sum), q), inverse_both);
  }
  return edge;
}

// Gradients of the three functions' potentials, from these and what they were made of; `value`: of the functions.
template <class D, class V, class T = hn::TFromD<D>>
HWY_INLINE void exact_gradients(D d, const SumTriangle<T>& panel, V height, V potential, V signed_angle,
                                const V (&value)[3], const Edge<V> (&edges)[3], Kernels<true, V>& out) {
  const Lanes3<V> normal = all(d, panel.normal);
  Lanes3<V> angle_slope{hn::Zero(d), hn::Zero(d), hn::Zero(d)}, inverse_slope[3];  // of height times inverse
  for (size_t e = 0; e < 3; ++e) {
    const Edge<V>& edge = edges[e];
    const Lanes3<V> outward = all(d, panel.outward[e]);
    angle_slope = mul_sub(mul_add(outward, height, normal * edge.distance), edge.cube, angle_slope);
    const Lanes3<V> slope =
        mul_add(mul_sub(normal, height, outward * edge.distance), edge.cube, all(d, panel.along[e]) * edge.turn);
    inverse_slope[e] = mul_add(slope, height, normal * edge.inverse);
  }
  for (size_t k = 0; k < 3; ++k) {
    const Lanes3<V> slope = all(d, panel.slope[k]);
    Lanes3<V> gradient = mul_sub(normal, out.dipole[0][k], slope * potential);
    Lanes3<V> dipole_gradient = mul_add(angle_slope, value[k], slope * signed_angle);
    for (size_t e = 0; e < 3; ++e) {
      const Edge<V>& edge = edges[e];
      const V across = hn::Set(d, panel.across[k][e]);
      const V share = hn::MulAdd(hn::MulAdd(edge.distance, across, value[k]), edge.inverse,
                                 hn::Mul(hn::Set(d, panel.alongside[k][e]), edge.first));
      gradient = mul_sub(all(d, panel.outward[e]), share, gradient);
      dipole_gradient = mul_sub(inverse_slope[e], across, dipole_gradient);
    }
    out.set_gradient(out.charge, k, gradient);
    out.set_gradient(out.dipole, k, dipole_gradient);
  }
}

// exact_potential in vectors; the solid angle is that of Van Oosterom and Strackee
// [1983]. `x`: from the panel's centre.
template <bool kGradients, class D, class V, class T = hn::TFromD<D>>
HWY_INLINE void exact(D d, const SumTriangle<T>& panel, const Lanes3<V>& x, Kernels<kGradients, V>& out) {
  const auto set = [&](double value) HWY_ATTR { return hn::Set(d, static_cast<T>(value)); };
  V height = dot(all(d, panel.normal), x);
  height = hn::IfThenZeroElse(hn::Lt(hn::Abs(height), set(kOnPlane)), height);
  V reach[3];  // of the corners
  for (size_t c = 0; c < 3; ++c) {
    const Lanes3<V> to = all(d, panel.corner[c]) - x;
    reach[c] = hn::Sqrt(hn::Max(dot(to, to), set(kNearestSquared)));
  }
  Edge<V> edges[3];
  V potential = hn::Zero(d), below = hn::Mul(hn::Mul(reach[0], reach[1]), reach[2]);
  for (size_t e = 0; e < 3; ++e) {
    edges[e] = edge_integrals<kGradients>(d, panel, e, x, height, reach[e], reach[(e + 1) % 3]);
    potential = hn::MulAdd(edges[e].distance, edges[e].inverse, potential);
    below = hn::MulAdd(edges[e].product, reach[(e + 2) % 3], below);
  }
  const V size = hn::Abs(height);
  const V angle = hn::Mul(set(2.0), angle_of(d, hn::Mul(set(2.0 * panel.area), size), below));
  potential = hn::NegMulAdd(size, angle, potential);
  const V signed_angle = hn::IfThenZeroElse(hn::Eq(height, hn::Zero(d)), hn::CopySign(angle, height));
  V value[3];  // of the functions, beyond the panel too
  for (size_t k = 0; k < 3; ++k) {
    value[k] = hn::Add(set(1 / 3.0), dot(all(d, panel.slope[k]), x));
    V charge = hn::Mul(value[k], potential), steep = hn::Zero(d);
    for (size_t e = 0; e < 3; ++e) {
      const V across = hn::Set(d, panel.across[k][e]);
      charge = hn::MulAdd(across, edges[e].radial, charge);
      steep = hn::MulAdd(across, edges[e].inverse, steep);
    }
    out.charge[0][k] = charge;
    out.dipole[0][k] = hn::NegMulAdd(height, steep, hn::Mul(value[k], signed_angle));
  }
  if constexpr (kGradients) exact_gradients(d, panel, height, potential, signed_angle, value, edges, out);
}

template <bool kGradients>
HWY_NOINLINE void exact_in_floats(const SumTriangle<float>& panel, const Lanes3<Floats>& x,
                                  FloatKernels<kGradients>& out) {
  exact<kGradients>(kTag, panel, x, out);
}

// In doubles, half a vector after the other.
template <bool kGradients>
HWY_NOINLINE void exact_in_doubles(const SumTriangle<double>& panel, const SumBatch& batch, size_t lane,
                                   FloatKernels<kGradients>& out) {
  const auto half = [&](size_t first) HWY_ATTR {
    const auto at = [&](size_t k) HWY_ATTR { return hn::Load(kDoubleTag, batch.exact_x[k] + lane + first); };
    const Lanes3<hn::Vec<DoubleTag>> x{at(0), at(1), at(2)};
    Kernels<kGradients, hn::Vec<DoubleTag>> kernels;
    exact<kGradients>(kDoubleTag, panel, x - all(kDoubleTag, panel.centre), kernels);
    return kernels;
  };
  const auto low = half(0), high = half(kWidth / 2);
  const auto join = [](auto a, auto b)
                        HWY_ATTR { return hn::Combine(kTag, hn::DemoteTo(kHalfTag, b), hn::DemoteTo(kHalfTag, a)); };
  for (size_t r = 0; r < out.kRows; ++r)
    for (size_t k = 0; k < 3; ++k) {
      out.charge[r][k] = join(low.charge[r][k], high.charge[r][k]);
      out.dipole[r][k] = join(low.dipole[r][k], high.dipole[r][k]);
    }
}

// Of one panel at a vector of points.
template <bool kGradients>
HWY_INLINE void evaluate_panel(const SumTables& tables, size_t p, const SumBatch& batch, size_t lane,
                               FloatKernels<kGradients>& out) {
  const SumPoints& panel = tables.points[p];
  const Lanes3<Floats> at{hn::Load(kTag, batch.x[0] + lane), hn::Load(kTag, batch.x[1] + lane),
                          hn::Load(kTag, batch.x[2] + lane)};
  const Lanes3<Floats> x = at - all(kTag, panel.centre);
  const Floats squared = dot(x, x);
  const auto within = [&](float limit) HWY_ATTR { return hn::Lt(squared, hn::Set(kTag, limit)); };
  const auto any = [](hn::Mask<Tag> mask) HWY_ATTR { return !hn::AllFalse(kTag, mask); };
  const auto far = hn::Not(within(panel.three_point_squared)), near = within(panel.seven_point_squared),
             beside = within(panel.exact_squared);
  if (any(far)) three_points(panel, x, out);
  if (hn::AllTrue(kTag, far)) return;
  FloatKernels<kGradients> closer;
  if (any(hn::Not(hn::Or(far, near)))) {
    seven_points(panel, x, closer);
    replace(hn::Not(far), closer, out);
  }
  if (!any(near)) return;
  if (any(hn::AndNot(beside, near))) {
    exact_in_floats(tables.triangles[p], x, closer);
    replace(near, closer, out);
  }
  if (!any(beside)) return;
  exact_in_doubles(tables.exact_triangles[p], batch, lane, closer);
  replace(beside, closer, out);
}

// Dipoles as shares of the corners of the panel's element.
template <bool kGradients>
HWY_INLINE void add_to_corners(const SumTables& tables, size_t p, const FloatKernels<kGradients>& kernels,
                               const SumBatch& batch, size_t lane) {
  const auto& shares = tables.shares[p];
  for (size_t r = 0; r < kernels.kRows; ++r)
    for (size_t c = 0; c < 4; ++c) {
      float* const sum = batch.corner_sums + (4 * r + c) * kSumPoints + lane;
      Floats total = hn::Load(kTag, sum);
      for (size_t k = 0; k < 3; ++k) total = hn::MulAdd(kernels.dipole[r][k], hn::Set(kTag, shares[k][c]), total);
      hn::Store(total, kTag, sum);
    }
}

// At the end of an element: from its corners to the columns of the basis.
template <bool kGradients>
void finish_element(const SumTables& tables, size_t element, const SumBatch& batch) {
  const size_t first = element == 0 ? 0 : tables.elements[element - 1].end_entry;
  for (size_t lane = 0; lane < batch.lanes; lane += kWidth) {
    for (size_t r = 0; r < (kGradients ? 4 : 1); ++r) {
      const float* const corners = batch.corner_sums + 4 * r * kSumPoints + lane;
      for (size_t i = first; i < tables.elements[element].end_entry; ++i) {
        const SumEntry& entry = tables.entries[i];
        float* const sum = batch.basis_sums + (r * tables.basis_count + entry.column) * kSumPoints + lane;
        hn::Store(hn::MulAdd(hn::Load(kTag, corners + entry.corner * kSumPoints), hn::Set(kTag, entry.weight),
                             hn::Load(kTag, sum)),
                  kTag, sum);
      }
    }
    Floats enclosed = hn::Load(kTag, batch.enclosed + lane);
    for (size_t c = 0; c < 4; ++c)
      enclosed = hn::Add(enclosed, hn::Load(kTag, batch.corner_sums + c * kSumPoints + lane));
    hn::Store(enclosed, kTag, batch.enclosed + lane);
  }
  for (size_t i = 0; i < (kGradients ? 4 : 1) * 4; ++i)
    std::fill_n(batch.corner_sums + i * kSumPoints, batch.lanes, 0.0f);
}

template <bool kGradients>
HWY_INLINE void fill_panel(const SumTables& tables, size_t p, size_t row, const SumBatch& batch) {
  for (size_t lane = 0; lane < batch.lanes; lane += kWidth) {
    FloatKernels<kGradients> kernels;
    evaluate_panel(tables, p, batch, lane, kernels);
    for (size_t r = 0; r < kernels.kRows; ++r)
      for (size_t k = 0; k < 3; ++k)
        hn::Store(kernels.charge[r][k], kTag, batch.kernels + (r * kSumRows + row + k) * kSumPoints + lane);
    if (!tables.shares.empty()) add_to_corners(tables, p, kernels, batch, lane);
  }
}

// Points in registers at a time, with up to three vectors of columns: as many accumulators as there are registers for.
constexpr size_t kBlockPoints = kWidth / 2;
constexpr size_t kBlockVectors = 3;

template <size_t kVectors>
HWY_INLINE void multiply_block(const float* HWY_RESTRICT kernels, const float* const* HWY_RESTRICT factors,
                               size_t column, size_t rows, float* HWY_RESTRICT sums, size_t columns) {
  Floats total[kBlockPoints][kVectors];
  HWY_UNROLL(8)
  for (size_t p = 0; p < kBlockPoints; ++p)
    for (size_t v = 0; v < kVectors; ++v) total[p][v] = hn::Load(kTag, sums + p * columns + v * kWidth);
  for (size_t i = 0; i < rows; ++i) {
    Floats factor[kVectors];
    for (size_t v = 0; v < kVectors; ++v) factor[v] = hn::Load(kTag, factors[i] + column + v * kWidth);
    HWY_UNROLL(8)
    for (size_t p = 0; p < kBlockPoints; ++p) {
      const Floats kernel = hn::Set(kTag, kernels[i * kSumPoints + p]);
      for (size_t v = 0; v < kVectors; ++v) total[p][v] = hn::MulAdd(kernel, factor[v], total[p][v]);
    }
  }
  HWY_UNROLL(8)
  for (size_t p = 0; p < kBlockPoints; ++p)
    for (size_t v = 0; v < kVectors; ++v) hn::Store(total[p][v], kTag, sums + p * columns + v * kWidth);
}

// Rows of factors that kernels are multiplied by: densities at the points of panels, or coefficients.
using FactorRows = std::array<const float*, kSumRows>;

// Adds the product of some rows of kernels with those of factors.
HWY_NOINLINE void multiply(const FactorRows& factors, size_t rows, const float* kernels, size_t points, size_t columns,
                           float* sums) {
  for (size_t column = 0; column < columns;) {
    const size_t vectors = std::min(kBlockVectors, (columns - column) / kWidth);
    for (size_t p = 0; p < points; p += kBlockPoints) {
      float* const to = sums + p * columns + column;
      if (vectors == 1) multiply_block<1>(kernels + p, factors.data(), column, rows, to, columns);
      if (vectors == 2) multiply_block<2>(kernels + p, factors.data(), column, rows, to, columns);
      if (vectors == 3) multiply_block<3>(kernels + p, factors.data(), column, rows, to, columns);
    }
    column += vectors * kWidth;
  }
}

// Of all kernels of the batch, those of values and those of gradients.
template <bool kGradients>
HWY_INLINE void multiply_all(const FactorRows& factors, size_t rows, size_t columns, const SumBatch& batch) {
  for (size_t r = 0; r < (kGradients ? 4 : 1); ++r)
    multiply(factors, rows, batch.kernels + r * kSumRows * kSumPoints, batch.points, columns,
             batch.sums + r * kSumPoints * columns);
}

template <bool kGradients>
void add_sums(const SumTables& tables, std::span<const uint32_t> panels, size_t columns, const SumBatch& batch) {
  const bool dipoles = !tables.shares.empty();
  size_t element = 0;
  for (size_t first = 0; first < panels.size(); first += kSumPanels) {
    const size_t count = std::min(panels.size() - first, kSumPanels);
    FactorRows factors;
    for (size_t i = 0; i < count; ++i) {
      const uint32_t p = panels[first + i];
      while (dipoles && tables.elements[element].end_panel <= p) ++element;
      for (size_t k = 0; k < 3; ++k) factors[3 * i + k] = tables.densities + (3 * p + k) * tables.density_stride;
      fill_panel<kGradients>(tables, p, 3 * i, batch);
      const bool last = first + i + 1 == panels.size();
      if (dipoles && (last || panels[first + i + 1] >= tables.elements[element].end_panel))
        finish_element<kGradients>(tables, element, batch);
    }
    multiply_all<kGradients>(factors, 3 * count, columns, batch);
  }
}

// R_l^m = r^l P_l^m(cos theta) e^(i m phi) / (l + m)! without the Condon-Shortley phase, up to m = 0 its real part,
// then its imaginary part, for all l and m >= 0; and, with d/dz R_l^m = R_(l-1)^m and (d/dx -+ i d/dy) R_l^m =
// +-R_(l-1)^(m -+ 1), their gradients.
template <bool kGradients>
void fill_harmonics(const SumExpansion& expansion, size_t lane, const SumBatch& batch) {
  constexpr size_t kDegree = kSumDegree;
  const auto row = [&](size_t r, size_t term)
                       HWY_ATTR { return batch.kernels + (r * kSumRows + term) * kSumPoints + lane; };
  const auto real = [](size_t l, size_t m) { return l * l + (m == 0 ? 0 : 2 * m - 1); };
  const auto imaginary = [](size_t l, size_t m) { return l * l + 2 * m; };
  const auto load = [&](size_t term) HWY_ATTR { return hn::Load(kTag, row(0, term)); };
  const auto store = [&](size_t r, size_t term, Floats value) HWY_ATTR { hn::Store(value, kTag, row(r, term)); };
  const auto set = [](double value) HWY_ATTR { return hn::Set(kTag, static_cast<float>(value)); };
  const Floats inverse_radius = hn::Set(kTag, expansion.inverse_radius);
  const Lanes3<Floats> at{hn::Load(kTag, batch.x[0] + lane), hn::Load(kTag, batch.x[1] + lane),
                          hn::Load(kTag, batch.x[2] + lane)};
  const Lanes3<Floats> x = (at - all(kTag, expansion.centre)) * inverse_radius;
  const Floats squared = dot(x, x);
  store(0, 0, set(1.0));
  for (size_t m = 0; m <= kDegree; ++m) {
    const size_t parts = m == 0 ? 1 : 2;
    const auto term = [&](size_t l, size_t part) { return part == 0 ? real(l, m) : imaginary(l, m); };
    if (m > 0) {
      const Floats a = load(real(m - 1, m - 1)), b = m > 1 ? load(imaginary(m - 1, m - 1)) : hn::Zero(kTag);
      const Floats factor = set(0.5 / static_cast<double>(m));
      store(0, real(m, m), hn::Mul(factor, hn::NegMulAdd(b, x.y, hn::Mul(a, x.x))));
      store(0, imaginary(m, m), hn::Mul(factor, hn::MulAdd(b, x.x, hn::Mul(a, x.y))));
    }
    for (size_t part = 0; part < parts; ++part)
      for (size_t l = m + 1; l <= kDegree; ++l) {
        const auto of = static_cast<double>((l + m) * (l - m));
        Floats value = hn::Mul(hn::Mul(set(static_cast<double>(2 * l - 1) / of), x.z), load(term(l - 1, part)));
        if (l > m + 1) value = hn::NegMulAdd(hn::Mul(set(1.0 / of), squared), load(term(l - 2, part)), value);
        store(0, term(l, part), value);
      }
  }
  if constexpr (kGradients) {
    const Floats half = hn::Mul(set(0.5), inverse_radius);
    const auto known = [&](size_t l, size_t m, size_t part) HWY_ATTR {  // 0 beyond m = l
      return m > l || (m == 0 && part == 1) ? hn::Zero(kTag) : load(part == 0 ? real(l, m) : imaginary(l, m));
    };
    for (size_t r = 1; r < 4; ++r) store(r, 0, hn::Zero(kTag));
    for (size_t l = 1; l <= kDegree; ++l) {
      store(1, real(l, 0), hn::Neg(hn::Mul(inverse_radius, known(l - 1, 1, 0))));
      store(2, real(l, 0), hn::Neg(hn::Mul(inverse_radius, known(l - 1, 1, 1))));
      store(3, real(l, 0), hn::Mul(inverse_radius, known(l - 1, 0, 0)));
      for (size_t m = 1; m <= l; ++m) {
        const Floats below_real = known(l - 1, m - 1, 0), below_imaginary = known(l - 1, m - 1, 1);
        const Floats above_real = known(l - 1, m + 1, 0), above_imaginary = known(l - 1, m + 1, 1);
        store(1, real(l, m), hn::Mul(half, hn::Sub(below_real, above_real)));
        store(1, imaginary(l, m), hn::Mul(half, hn::Sub(below_imaginary, above_imaginary)));
        store(2, real(l, m), hn::Neg(hn::Mul(half, hn::Add(below_imaginary, above_imaginary))));
        store(2, imaginary(l, m), hn::Mul(half, hn::Add(below_real, above_real)));
        store(3, real(l, m), hn::Mul(inverse_radius, known(l - 1, m, 0)));
        store(3, imaginary(l, m), hn::Mul(inverse_radius, known(l - 1, m, 1)));
      }
    }
  }
}

template <bool kGradients>
void add_harmonics(const SumExpansion& expansion, size_t columns, const SumBatch& batch) {
  FactorRows factors;
  for (size_t i = 0; i < kSumTerms; ++i) factors[i] = expansion.coefficients + i * expansion.stride;
  for (size_t lane = 0; lane < batch.lanes; lane += kWidth) {
    fill_harmonics<kGradients>(expansion, lane, batch);
    Floats enclosed = hn::Load(kTag, batch.enclosed + lane);
    for (size_t i = 0; i < kSumTerms; ++i)
      enclosed = hn::MulAdd(hn::Load(kTag, batch.kernels + i * kSumPoints + lane), hn::Set(kTag, expansion.enclosed[i]),
                            enclosed);
    hn::Store(enclosed, kTag, batch.enclosed + lane);
  }
  multiply_all<kGradients>(factors, kSumTerms, columns, batch);
}

void sum(const SumTables& tables, std::span<const uint32_t> panels, bool gradients, size_t columns,
         const SumBatch& batch) {
  gradients ? add_sums<true>(tables, panels, columns, batch) : add_sums<false>(tables, panels, columns, batch);
}

void expand(const SumExpansion& expansion, bool gradients, size_t columns, const SumBatch& batch) {
  gradients ? add_harmonics<true>(expansion, columns, batch) : add_harmonics<false>(expansion, columns, batch);
}

}  // namespace barycast::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace barycast {
namespace {

HWY_EXPORT(sum);
HWY_EXPORT(expand);

}  // namespace

void add_panel_sums(const SumTables& tables, std::span<const uint32_t> panels, bool gradients, size_t columns,
                    const SumBatch& batch) {
  HWY_DYNAMIC_DISPATCH(sum)(tables, panels, gradients, columns, batch);
}

void add_expansion(const SumExpansion& expansion, bool gradients, size_t columns, const SumBatch& batch) {
  HWY_DYNAMIC_DISPATCH(expand)(expansion, gradients, columns, batch);
}

}  // namespace barycast
#endif
