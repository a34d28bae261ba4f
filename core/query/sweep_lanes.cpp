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

void prepare(const SweepBlock& block, const std::array<float, 3>& point, PencilBlock& out) {
  const size_t corners = block.quads ? 4 : 3, edges = block.quads ? 6 : 3;
  const size_t* const from = block.quads ? kFrom : kTriangleFrom;
  const size_t* const to = block.quads ? kTo : kTriangleTo;
  for (size_t first = 0; first < kSweepLanes; first += kWidth) {
    Floats p[4][3];
    Floats farthest = hn::Zero(kTag);
    for (size_t c = 0; c < corners; ++c) {
      Floats squared = hn::Zero(kTag);
      for (size_t k = 0; k < 3; ++k) {
        p[c][k] = hn::Sub(hn::Load(kTag, block.corner[c][k].data() + first), hn::Set(kTag, point[k]));
        squared = hn::MulAdd(p[c][k], p[c][k], squared);
      }
      farthest = hn::Max(farthest, squared);
    }
    for (size_t e = 0; e < edges; ++e) {
      const Floats* const a = p[from[e]];
      const Floats* const b = p[to[e]];
      for (size_t k = 0; k < 3; ++k) {
        const size_t i = (k + 1) % 3, j = (k + 2) % 3;
        hn::Store(hn::MulSub(a[i], b[j], hn::Mul(a[j], b[i])), kTag, out.normal[e][k].data() + first);
      }
    }
    const Floats distance = hn::Sqrt(farthest);
    hn::Store(hn::Mul(hn::Mul(hn::Set(kTag, kMargin), hn::Add(distance, hn::Set(kTag, kRounded))),
                      hn::Add(distance, hn::Set(kTag, 1.0f))),
              kTag, out.margin.data() + first);
  }
}

uint32_t meets(const SweepBlock& block, const PencilBlock& pencil, const std::array<float, 3>& direction) {
  const Floats x = hn::Set(kTag, direction[0]), y = hn::Set(kTag, direction[1]), z = hn::Set(kTag, direction[2]);
  uint32_t result = 0;
  for (size_t first = 0; first < kSweepLanes; first += kWidth) {
    const auto side = [&](size_t edge) {
      const auto& n = pencil.normal[edge];
      return hn::MulAdd(
          x, hn::Load(kTag, n[0].data() + first),
          hn::MulAdd(y, hn::Load(kTag, n[1].data() + first), hn::Mul(z, hn::Load(kTag, n[2].data() + first))));
    };
    const Floats margin = hn::Load(kTag, pencil.margin.data() + first);
    // How clearly three sides differ, negative where they may be the same.
    const auto apart = [](Floats a, Floats b, Floats c) {
      const Floats least = hn::Min(a, hn::Min(b, c)), most = hn::Max(a, hn::Max(b, c));
      return hn::Min(hn::Neg(least), most);
    };
    Floats clearly;
    if (block.quads) {
      const Floats s01 = side(0), s12 = side(1), s23 = side(2), s30 = side(3), s02 = side(4), s13 = side(5);
      clearly = hn::Min(hn::Min(apart(s01, s12, hn::Neg(s02)), apart(s02, s23, s30)),
                        hn::Min(apart(s01, s13, s30), apart(s12, s23, hn::Neg(s13))));
    } else {
      clearly = apart(side(0), side(1), side(2));
    }
    uint8_t bits[8] = {};
    hn::StoreMaskBits(kTag, hn::Le(clearly, margin), bits);
    result |= static_cast<uint32_t>(bits[0] | bits[1] << 8) << first;
  }
  return result & ((1u << block.count) - 1);
}

}  // namespace barycast::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace barycast {
namespace {

HWY_EXPORT(prepare);
HWY_EXPORT(meets);

}  // namespace

void prepare_pencil(const SweepBlock& block, const std::array<float, 3>& point, PencilBlock& out) {
  HWY_DYNAMIC_DISPATCH(prepare)(block, point, out);
}

uint32_t may_meet(const SweepBlock& block, const PencilBlock& pencil, const std::array<float, 3>& direction) {
  return HWY_DYNAMIC_DISPATCH(meets)(block, pencil, direction);
}

}  // namespace barycast
#endif
