#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "query/grid_lanes.cpp"  // this file, once for every processor
#include "query/grid_lanes.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <cmath>
#include <limits>

HWY_BEFORE_NAMESPACE();
namespace barycast::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
// Vectors hold one block, or two where they are twice as wide.
using Tag = hn::CappedTag<float, 2 * kBlockLanes>;
using BlockTag = hn::CappedTag<float, kBlockLanes>;
using IntTag = hn::RebindToSigned<Tag>;
using Floats = hn::Vec<Tag>;
using Ints = hn::Vec<IntTag>;
constexpr Tag kTag;
[[maybe_unused]] constexpr BlockTag kBlockTag;
constexpr IntTag kIntTag;
constexpr size_t kWidth = hn::MaxLanes(kTag);
constexpr size_t kBlocksPerVector = kWidth / kBlockLanes;

struct Point {
  Floats x, y, z;
};

// The blocks that are looked at together.
struct Blocks {
  const TriangleBlock *low, *high;
  HWY_INLINE Floats row(size_t r) const {
#if HWY_TARGET == HWY_AVX2
    return hn::Load(kTag, low->row[r].data());
#else
    return hn::Combine(kTag, hn::Load(kBlockTag, high->row[r].data()), hn::Load(kBlockTag, low->row[r].data()));
#endif
  }
};

HWY_INLINE Floats linear(const Blocks& blocks, size_t row, const Point& p) {
  return hn::MulAdd(p.x, blocks.row(row),
                    hn::MulAdd(p.y, blocks.row(row + 1), hn::MulAdd(p.z, blocks.row(row + 2), blocks.row(row + 3))));
}

HWY_INLINE Floats beyond(Floats along, Floats length) {
  return hn::Sub(along, hn::Min(hn::Max(along, hn::Zero(kTag)), length));
}

// Squared distances to the triangles.
HWY_INLINE Floats squared(const Blocks& blocks, const Point& p) {
  using B = TriangleBlock;
  const Floats along = linear(blocks, B::kAlong, p), inward = linear(blocks, B::kInward, p),
               normal = linear(blocks, B::kNormal, p), length = blocks.row(B::kLength);

  const Floats over0 = beyond(along, length);
  const Floats edge0 = hn::MulAdd(over0, over0, hn::Mul(inward, inward));

  const Floats from = hn::Sub(along, length), x1 = blocks.row(B::kSecond), y1 = blocks.row(B::kSecond + 1);
  const Floats over1 = beyond(hn::MulAdd(from, x1, hn::Mul(inward, y1)), blocks.row(B::kSecond + 2));
  const Floats left1 = hn::MulSub(inward, x1, hn::Mul(from, y1));
  const Floats edge1 = hn::MulAdd(over1, over1, hn::Mul(left1, left1));

  const Floats x2 = blocks.row(B::kThird), y2 = blocks.row(B::kThird + 1);
  const Floats over2 = beyond(hn::MulAdd(along, x2, hn::Mul(inward, y2)), blocks.row(B::kThird + 2));
  const Floats right2 = hn::MulSub(along, y2, hn::Mul(inward, x2));
  const Floats edge2 = hn::MulAdd(over2, over2, hn::Mul(right2, right2));

  const auto inside = hn::Ge(hn::Min(inward, hn::Min(left1, right2)), hn::Zero(kTag));
  const Floats in_plane = hn::IfThenZeroElse(inside, hn::Min(edge0, hn::Min(edge1, edge2)));
  return hn::MulAdd(normal, normal, in_plane);
}

// The least lane of every vector, in order: lane i of the result is that of row[i].
HWY_INLINE Floats least_of_rows(const Floats (&row)[kWidth]) {
  const hn::RepartitionToWide<Tag> wide;
  Floats quads[kWidth / 4];  // by 128 bits: of four rows, the least of the four lanes there
  for (size_t q = 0; q < kWidth / 4; ++q) {
    const auto pair = [&](size_t i) {
      return hn::Min(hn::InterleaveLower(kTag, row[i], row[i + 1]), hn::InterleaveUpper(kTag, row[i], row[i + 1]));
    };
    const auto a = hn::BitCast(wide, pair(4 * q)), b = hn::BitCast(wide, pair(4 * q + 2));
    quads[q] =
        hn::Min(hn::BitCast(kTag, hn::InterleaveLower(wide, a, b)), hn::BitCast(kTag, hn::InterleaveUpper(wide, a, b)));
  }
  // Of neighbouring 128 bits: those of `even` into even places, those of `odd` into odd ones.
  const auto fold = [](Floats even, Floats odd) {
    return hn::Min(hn::OddEvenBlocks(hn::SwapAdjacentBlocks(odd), even),
                   hn::OddEvenBlocks(odd, hn::SwapAdjacentBlocks(even)));
  };
#if HWY_TARGET == HWY_AVX2
  return fold(quads[0], quads[1]);
#else
  const Floats low = fold(quads[0], quads[1]), high = fold(quads[2], quads[3]);
  return hn::Min(hn::ConcatLowerLower(kTag, high, low), hn::ConcatUpperUpper(kTag, high, low));
#endif
}

// Indices of cells in the table, and which positions are in the lattice.
HWY_INLINE hn::Mask<Tag> lookup(const GridLattice& lattice, const Point& p, Ints& cell) {
  const Floats scale = hn::Set(kTag, lattice.inverse_cell);
  auto in = hn::FirstN(kTag, kWidth);
  const auto axis = [&](Floats x, size_t k) {
    const Floats steps = hn::Mul(hn::Sub(x, hn::Set(kTag, lattice.low[k])), scale);
    in = hn::And(
        in, hn::And(hn::Ge(steps, hn::Zero(kTag)), hn::Lt(steps, hn::Set(kTag, static_cast<float>(lattice.count[k])))));
    return hn::ConvertTo(kIntTag, steps);
  };
  const auto count = [&](size_t k) { return hn::Set(kIntTag, static_cast<int32_t>(lattice.count[k])); };
  const Ints x = axis(p.x, 0), y = axis(p.y, 1), z = axis(p.z, 2);
  const Ints index = hn::Add(hn::Mul(hn::Add(hn::Mul(z, count(1)), y), count(0)), x);
  cell = hn::Add(index, hn::Set(kIntTag, static_cast<int32_t>(lattice.first)));
  return in;
}

// Squared distances to the triangles of a list, the least in every lane.
HWY_INLINE Floats least_of_list(const GridTables& grid, uint32_t cell, const Point& p) {
  const uint32_t* block = grid.lists.data() + grid_list_begin(cell);
  const uint32_t* const end = block + grid_list_length(cell);
  const auto at = [&](size_t k) { return &grid.blocks[block[k]]; };
  Floats least = squared({at(0), at(kBlocksPerVector - 1)}, p);
  for (block += kBlocksPerVector; block < end; block += kBlocksPerVector)
    least = hn::Min(least, squared({at(0), at(kBlocksPerVector - 1)}, p));
  return least;
}

// Of positions in cells without a list.
float far_radius(const GridTables& grid, uint32_t cell, float x, float y, float z) {
  if (cell == kNoCell) return kNotInGrid;
  const GridFar& far = grid.far[cell & ~kGridFarBit];
  x -= far.centre[0];
  y -= far.centre[1];
  z -= far.centre[2];
  return std::max(0.0f,
                  far.distance - std::sqrt(x * x + y * y + z * z) * (1.0f + kBlockRelativeRounding) - kBlockRounding);
}

void radii(const GridTables& grid, const WalkPositions& at, float* out) {
  for (size_t begin = 0; begin < at.count; begin += kWidth) {
    const Point p{hn::LoadU(kTag, at.x + begin), hn::LoadU(kTag, at.y + begin), hn::LoadU(kTag, at.z + begin)};
    Ints inner_cell, outer_cell;
    const auto in_inner = lookup(grid.inner, p, inner_cell), in_outer = lookup(grid.outer, p, outer_cell);
    const Ints cell = hn::IfThenElse(hn::RebindMask(kIntTag, in_inner), inner_cell, outer_cell);
    const auto in_grid = hn::RebindMask(kIntTag, hn::Or(in_inner, in_outer));
    const Ints found = hn::IfThenElse(in_grid,
                                      hn::GatherIndex(kIntTag, reinterpret_cast<const int32_t*>(grid.cells.data()),
                                                      hn::IfThenElseZero(in_grid, cell)),
                                      hn::Set(kIntTag, -1));
    HWY_ALIGN int32_t values[kWidth];
    hn::Store(found, kIntTag, values);
    const auto is_listed = hn::Not(hn::Lt(found, hn::Zero(kIntTag)));
    Floats rows[kWidth];
    for (size_t i = 0; i < kWidth; ++i) {
      const size_t k = begin + i;
      rows[i] = values[i] < 0 ? hn::Zero(kTag)
                              : least_of_list(grid, static_cast<uint32_t>(values[i]),
                                              {hn::Set(kTag, at.x[k]), hn::Set(kTag, at.y[k]), hn::Set(kTag, at.z[k])});
    }
    const Floats distance = hn::Sqrt(least_of_rows(rows));
    const Ints list = hn::IfThenElseZero(is_listed, hn::ShiftRight<int{kGridLengthBits}>(found));
    const Floats slack = hn::GatherIndex(kTag, grid.slack.data(), list);
    const Floats radius = hn::Sub(hn::Mul(distance, hn::Set(kTag, 1.0f - kBlockRelativeRounding)), slack);
    hn::StoreU(hn::Max(hn::Zero(kTag), radius), kTag, out + begin);
    if (hn::AllTrue(kIntTag, is_listed)) continue;
    for (size_t i = 0; i < kWidth && begin + i < at.count; ++i)
      if (values[i] < 0)
        out[begin + i] =
            far_radius(grid, static_cast<uint32_t>(values[i]), at.x[begin + i], at.y[begin + i], at.z[begin + i]);
  }
}

uint32_t nearest(const GridTables& grid, uint32_t cell, const std::array<float, 3>& point) {
  const Point p{hn::Set(kTag, point[0]), hn::Set(kTag, point[1]), hn::Set(kTag, point[2])};
  const uint32_t* const block = grid.lists.data() + grid_list_begin(cell);
  const uint32_t length = grid_list_length(cell);
  Floats least = hn::Set(kTag, std::numeric_limits<float>::infinity());
  Ints place = hn::Zero(kIntTag);  // of the least, in lanes from the beginning of the list
  for (uint32_t k = 0; k < length; k += kBlocksPerVector) {
    const Floats distances = squared({&grid.blocks[block[k]], &grid.blocks[block[k + kBlocksPerVector - 1]]}, p);
    const auto nearer = hn::Lt(distances, least);
    least = hn::Min(distances, least);
    place = hn::IfThenElse(hn::RebindMask(kIntTag, nearer), hn::Iota(kIntTag, static_cast<int32_t>(k * kBlockLanes)),
                           place);
  }
  HWY_ALIGN float distance[kWidth];
  HWY_ALIGN int32_t places[kWidth];
  hn::Store(least, kTag, distance);
  hn::Store(place, kIntTag, places);
  size_t best = 0;
  for (size_t i = 1; i < kWidth; ++i)
    if (distance[i] < distance[best] || (distance[i] == distance[best] && places[i] < places[best])) best = i;
  const auto at = static_cast<uint32_t>(places[best]);
  return grid.blocks[block[at / kBlockLanes]].triangle[at % kBlockLanes];
}

void distances_squared(const TriangleBlock& block, const std::array<float, 3>& point, TriangleBlock::Lanes& out) {
  const Floats distances =
      squared({&block, &block}, {hn::Set(kTag, point[0]), hn::Set(kTag, point[1]), hn::Set(kTag, point[2])});
#if HWY_TARGET == HWY_AVX2
  hn::StoreU(distances, kTag, out.data());
#else
  hn::StoreU(hn::LowerHalf(kBlockTag, distances), kBlockTag, out.data());
#endif
}

}  // namespace barycast::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace barycast {
namespace {

HWY_EXPORT(radii);
HWY_EXPORT(distances_squared);
HWY_EXPORT(nearest);

// The same cell as the vector code finds: the same operations, each rounded.
bool find(const GridLattice& lattice, const std::array<float, 3>& point, uint32_t& cell) {
  std::array<uint32_t, 3> index;
  for (size_t k = 0; k < 3; ++k) {
    const float steps = (point[k] - lattice.low[k]) * lattice.inverse_cell;
    if (!(steps >= 0.0f && steps < static_cast<float>(lattice.count[k]))) return false;
    index[k] = static_cast<uint32_t>(steps);
  }
  cell = lattice.first + (index[2] * lattice.count[1] + index[1]) * lattice.count[0] + index[0];
  return true;
}

}  // namespace

void block_distances_squared(const TriangleBlock& block, const std::array<float, 3>& point,
                             TriangleBlock::Lanes& squared) {
  HWY_DYNAMIC_DISPATCH(distances_squared)(block, point, squared);
}

uint32_t grid_nearest(const GridTables& grid, uint32_t cell, const std::array<float, 3>& point) {
  return HWY_DYNAMIC_DISPATCH(nearest)(grid, cell, point);
}

void grid_radii(const GridTables& grid, const WalkPositions& at, float* radii_out) {
  HWY_DYNAMIC_DISPATCH(radii)(grid, at, radii_out);
}

uint32_t grid_cell(const GridTables& grid, const std::array<float, 3>& point) {
  uint32_t cell = 0;
  if (find(grid.inner, point, cell) || find(grid.outer, point, cell)) return grid.cells[cell];
  return kNoCell;
}

}  // namespace barycast
#endif
