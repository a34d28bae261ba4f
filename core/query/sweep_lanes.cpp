#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "query/sweep_lanes.cpp"  // this file, once for every processor
#include "query/sweep_lanes.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace barycast::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using Tag = hn::CappedTag<float, kSweepLanes>;
using Floats = hn::Vec<Tag>;
constexpr Tag kTag;
constexpr size_t kWidth = hn::MaxLanes(kTag);

// Of a product of a normal with a direction, over (P + kRounded) (1 + P), P being the distance of the farthest corner:
// positions are rounded by 3e-7, whatever their distance, and products by some roundings of their size.
constexpr float kMargin = 4e-6f, kRounded = 1e-6f;

constexpr size_t kFrom[6] = {0, 1, 2, 3, 0, 1}, kTo[6] = {1, 2, 3, 0, 2, 3};
constexpr size_t kTriangleFrom[3] = {0, 1, 2}, kTriangleTo[3] = {1, 2, 0};

// Normals of the planes that the point and edges span, and what the product of one of them with a direction may be off
// by.
template <bool kQuads>
struct Planes {
  static constexpr size_t kCorners = kQuads ? 4 : 3, kEdges = kQuads ? 6 : 3;
  Floats normal[kEdges][3];
  Floats margin;

  HWY_INLINE Planes(const SweepBlock& block, const std::array<float, 3>& point, size_t first) {
    Floats p[kCorners][3];
    Floats farthest = hn::Zero(kTag);
    for (size_t c = 0; c < kCorners; ++c) {
      Floats squared = hn::Zero(kTag);
      for (size_t k = 0; k < 3; ++k) {
        p[c][k] = hn::Sub(hn::Load(kTag, block.corner[c][k].data() + first), hn::Set(kTag, point[k]));
        squared = hn::MulAdd(p[c][k], p[c][k], squared);
      }
      farthest = hn::Max(farthest, squared);
    }
    for (size_t e = 0; e < kEdges; ++e) {
      const Floats* const a = p[kQuads ? kFrom[e] : kTriangleFrom[e]];
      const Floats* const b = p[kQuads ? kTo[e] : kTriangleTo[e]];
      for (size_t k = 0; k < 3; ++k) {
        const size_t i = (k + 1) % 3, j = (k + 2) % 3;
        normal[e][k] = hn::MulSub(a[i], b[j], hn::Mul(a[j], b[i]));
      }
    }
    const Floats distance = hn::Sqrt(farthest);
    margin = hn::Mul(hn::Mul(hn::Set(kTag, kMargin), hn::Add(distance, hn::Set(kTag, kRounded))),
                     hn::Add(distance, hn::Set(kTag, 1.0f)));
  }
};

// How clearly three sides differ, negative where they may be the same.
HWY_INLINE Floats apart(Floats a, Floats b, Floats c) {
  const Floats least = hn::Min(a, hn::Min(b, c)), most = hn::Max(a, hn::Max(b, c));
  return hn::Min(hn::Neg(least), most);
}

template <bool kQuads>
void sweep(const SweepBlock& block, const std::array<float, 3>& point, const SweepDirections& directions,
           uint16_t* may_meet) {
  const uint32_t used = (1u << block.count) - 1;
  for (size_t first = 0; first < block.count; first += kWidth) {
    const Planes<kQuads> planes(block, point, first);
    for (size_t line = 0; line < directions.count; ++line) {
      const Floats x = hn::Set(kTag, directions.x[line]), y = hn::Set(kTag, directions.y[line]),
                   z = hn::Set(kTag, directions.z[line]);
      const auto side = [&](size_t edge) {
        const auto& n = planes.normal[edge];
        return hn::MulAdd(x, n[0], hn::MulAdd(y, n[1], hn::Mul(z, n[2])));
      };
      Floats clearly;
      if constexpr (kQuads) {
        const Floats s01 = side(0), s12 = side(1), s23 = side(2), s30 = side(3), s02 = side(4), s13 = side(5);
        clearly = hn::Min(apart(s01, s12, hn::Neg(s02)), hn::Min(apart(s02, s23, s30), apart(s01, s13, s30)));
      } else {
        clearly = apart(side(0), side(1), side(2));
      }
      uint8_t bits[8] = {};
      hn::StoreMaskBits(kTag, hn::Le(clearly, planes.margin), bits);
      const uint32_t lanes = static_cast<uint32_t>(bits[0] | bits[1] << 8) << first & used;
      may_meet[line] = static_cast<uint16_t>(first == 0 ? lanes : may_meet[line] | lanes);
    }
  }
}

void sweep_quads(const SweepBlock& block, const std::array<float, 3>& point, const SweepDirections& directions,
                 uint16_t* may_meet) {
  sweep<true>(block, point, directions, may_meet);
}
void sweep_triangles(const SweepBlock& block, const std::array<float, 3>& point, const SweepDirections& directions,
                     uint16_t* may_meet) {
  sweep<false>(block, point, directions, may_meet);
}

}  // namespace barycast::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace barycast {
namespace {

HWY_EXPORT(sweep_quads);
HWY_EXPORT(sweep_triangles);

}  // namespace

void sweep_lines(const SweepBlock& block, const std::array<float, 3>& point, const SweepDirections& directions,
                 uint16_t* may_meet) {
  if (block.quads)
    HWY_DYNAMIC_DISPATCH(sweep_quads)(block, point, directions, may_meet);
  else
    HWY_DYNAMIC_DISPATCH(sweep_triangles)(block, point, directions, may_meet);
}

}  // namespace barycast
#endif
