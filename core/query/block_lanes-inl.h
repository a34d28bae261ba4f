// Blocks of triangles in vectors, for the files that are compiled once for every processor: include it after
// hwy/foreach_target.h.

#if defined(BARYCAST_BLOCK_LANES_INL) == defined(HWY_TARGET_TOGGLE)
#ifdef BARYCAST_BLOCK_LANES_INL
#undef BARYCAST_BLOCK_LANES_INL
#else
#define BARYCAST_BLOCK_LANES_INL
#endif

#include <hwy/highway.h>

#include "query/triangle_block.h"

HWY_BEFORE_NAMESPACE();
namespace barycast::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
// Vectors hold a block: as many positions at a time.
using Tag = hn::CappedTag<float, kBlockLanes>;
using IntTag = hn::RebindToSigned<Tag>;
using Floats = hn::Vec<Tag>;
using Ints = hn::Vec<IntTag>;
constexpr Tag kTag;
constexpr IntTag kIntTag;
constexpr size_t kWidth = kBlockLanes;
static_assert(hn::MaxLanes(kTag) == kWidth);

struct Point {
  Floats x, y, z;
};

HWY_INLINE Point point_of(const std::array<float, 3>& p) {
  return {hn::Set(kTag, p[0]), hn::Set(kTag, p[1]), hn::Set(kTag, p[2])};
}

template <class Block>
HWY_INLINE Floats row(const Block& block, size_t r) {
  return hn::Load(kTag, block.row[r].data());
}

template <class Block>
HWY_INLINE Floats linear(const Block& block, size_t r, const Point& p) {
  return hn::MulAdd(p.x, row(block, r),
                    hn::MulAdd(p.y, row(block, r + 1), hn::MulAdd(p.z, row(block, r + 2), row(block, r + 3))));
}

// Squared bounds of the distances to the triangles.
HWY_INLINE Floats bound(const BoundBlock& block, const Point& p) {
  using B = BoundBlock;
  const Floats normal = linear(block, B::kNormal, p), inside0 = linear(block, B::kInside, p),
               inside1 = linear(block, B::kInside + 4, p), inside2 = linear(block, B::kInside + 8, p);
  const Floats outside = hn::Min(hn::Min(hn::Zero(kTag), inside0), hn::Min(inside1, inside2));
  return hn::MulAdd(normal, normal, hn::Mul(outside, outside));
}

}  // namespace barycast::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
