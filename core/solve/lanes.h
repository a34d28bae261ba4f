#pragma once

// Four doubles at a time, one per query point, by Google Highway for the processor baseline alone: include it in
// .cpp files only. A lane never sees its neighbours, so that a point's bits do not depend on the points beside it.

#include <hwy/highway.h>

#include <array>
#include <cstddef>

#include "base/vector.h"

static_assert(HWY_TARGET == HWY_AVX2, "Highway must compile for the baseline: HWY_DISABLE_PCLMUL_AES, x86-64-v3");

HWY_BEFORE_NAMESPACE();
namespace barycast {

namespace hn = hwy::HWY_NAMESPACE;

inline constexpr hn::FixedTag<double, 4> kLaneTag;
using Lane = hn::Vec<hn::FixedTag<double, 4>>;
// Column i holds the lanes of value i; Eigen aligns them.
using LaneTable = Eigen::Matrix<double, 4, Eigen::Dynamic>;

struct Lane3 {
  Lane x, y, z;
};

HWY_INLINE Lane all(double value) {
  return hn::Set(kLaneTag, value);
}
HWY_INLINE Lane3 all(const Vec<3>& v) {
  return {all(v[0]), all(v[1]), all(v[2])};
}

// Point i into lane i.
HWY_INLINE Lane3 gather(const std::array<Vec<3>, 4>& points) {
  alignas(32) double coordinate[3][4];
  for (size_t i = 0; i < 4; ++i)
    for (size_t k = 0; k < 3; ++k) coordinate[k][i] = points[i][static_cast<Eigen::Index>(k)];
  return {hn::Load(kLaneTag, coordinate[0]), hn::Load(kLaneTag, coordinate[1]), hn::Load(kLaneTag, coordinate[2])};
}

HWY_INLINE Lane load(const LaneTable& table, size_t i) {
  return hn::Load(kLaneTag, table.data() + 4 * i);
}
HWY_INLINE Lane3 load3(const LaneTable& table, size_t i) {
  return {load(table, 3 * i), load(table, 3 * i + 1), load(table, 3 * i + 2)};
}
HWY_INLINE void store(Lane value, LaneTable& table, size_t i) {
  hn::Store(value, kLaneTag, table.data() + 4 * i);
}
HWY_INLINE void store3(const Lane3& value, LaneTable& table, size_t i) {
  store(value.x, table, 3 * i);
  store(value.y, table, 3 * i + 1);
  store(value.z, table, 3 * i + 2);
}
HWY_INLINE void add_to(Lane value, LaneTable& table, size_t i) {
  store(hn::Add(load(table, i), value), table, i);
}
HWY_INLINE void add_to3(const Lane3& value, LaneTable& table, size_t i) {
  add_to(value.x, table, 3 * i);
  add_to(value.y, table, 3 * i + 1);
  add_to(value.z, table, 3 * i + 2);
}

HWY_INLINE Lane dot(const Lane3& a, const Lane3& b) {
  return hn::MulAdd(a.x, b.x, hn::MulAdd(a.y, b.y, hn::Mul(a.z, b.z)));
}
HWY_INLINE Lane3 cross(const Lane3& a, const Lane3& b) {
  return {hn::MulSub(a.y, b.z, hn::Mul(a.z, b.y)), hn::MulSub(a.z, b.x, hn::Mul(a.x, b.z)),
          hn::MulSub(a.x, b.y, hn::Mul(a.y, b.x))};
}
// a s + b
HWY_INLINE Lane3 mul_add(const Lane3& a, Lane s, const Lane3& b) {
  return {hn::MulAdd(a.x, s, b.x), hn::MulAdd(a.y, s, b.y), hn::MulAdd(a.z, s, b.z)};
}
HWY_INLINE Lane3 operator*(const Lane3& a, Lane s) {
  return {hn::Mul(a.x, s), hn::Mul(a.y, s), hn::Mul(a.z, s)};
}
HWY_INLINE Lane3 operator+(const Lane3& a, const Lane3& b) {
  return {hn::Add(a.x, b.x), hn::Add(a.y, b.y), hn::Add(a.z, b.z)};
}
HWY_INLINE Lane3 operator-(const Lane3& a, const Lane3& b) {
  return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)};
}

}  // namespace barycast
HWY_AFTER_NAMESPACE();
