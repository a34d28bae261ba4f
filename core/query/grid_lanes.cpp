#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "query/grid_lanes.cpp"  // this file, once for every processor
#include "query/grid_lanes.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "query/block_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace barycast::HWY_NAMESPACE {

HWY_INLINE Floats beyond(Floats along, Floats length) {
  return hn::Sub(along, hn::Min(hn::Max(along, hn::Zero(kTag)), length));
}

// Squared distances to the triangles.
HWY_INLINE Floats distance(const DistanceBlock& block, const Point& p) {
  using B = DistanceBlock;
  const auto at = [&](size_t r) { return row(block, r); };
  const Floats along = linear(block, B::kAlong, p), inward = linear(block, B::kInward, p),
               normal = linear(block, B::kNormal, p), length = at(B::kLength);

  const Floats over0 = beyond(along, length);
  const Floats edge0 = hn::MulAdd(over0, over0, hn::Mul(inward, inward));

  const Floats from = hn::Sub(along, length), x1 = at(B::kSecond), y1 = at(B::kSecond + 1);
  const Floats over1 = beyond(hn::MulAdd(from, x1, hn::Mul(inward, y1)), at(B::kSecond + 2));
  const Floats left1 = hn::MulSub(inward, x1, hn::Mul(from, y1));
  const Floats edge1 = hn::MulAdd(over1, over1, hn::Mul(left1, left1));

  const Floats x2 = at(B::kThird), y2 = at(B::kThird + 1);
  const Floats over2 = beyond(hn::MulAdd(along, x2, hn::Mul(inward, y2)), at(B::kThird + 2));
  const Floats right2 = hn::MulSub(along, y2, hn::Mul(inward, x2));
  const Floats edge2 = hn::MulAdd(over2, over2, hn::Mul(right2, right2));

  const auto inside = hn::Ge(hn::Min(inward, hn::Min(left1, right2)), hn::Zero(kTag));
  const Floats in_plane = hn::IfThenZeroElse(inside, hn::Min(edge0, hn::Min(edge1, edge2)));
  return hn::MulAdd(normal, normal, in_plane);
}

// The least lane of every vector, in order: lane i of the result is that of row[i].
HWY_INLINE Floats least_of_rows(const Floats (&row)[kWidth]) {
  const hn::RepartitionToWide<Tag> wide;
  const auto pair = [&](size_t i) {
    return hn::Min(hn::InterleaveLower(kTag, row[i], row[i + 1]), hn::InterleaveUpper(kTag, row[i], row[i + 1]));
  };
  // By 128 bits: of four rows, the least of the four lanes there.
  const auto quad = [&](size_t i) {
    const auto a = hn::BitCast(wide, pair(i)), b = hn::BitCast(wide, pair(i + 2));
    return hn::Min(hn::BitCast(kTag, hn::InterleaveLower(wide, a, b)),
                   hn::BitCast(kTag, hn::InterleaveUpper(wide, a, b)));
  };
  const Floats low = quad(0), high = quad(4);
  return hn::Min(hn::ConcatLowerLower(kTag, high, low), hn::ConcatUpperUpper(kTag, high, low));
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

// Squared bounds of a list, the least of every lane.
HWY_INLINE Floats least_of_list(const GridTables& grid, uint32_t cell, const Point& p) {
  const uint32_t* block = grid.lists.data() + grid_list_begin(cell) + 1;
  const uint32_t* const end = block + grid_list_length(cell);
  Floats least = bound(grid.blocks[*block], p);
  for (++block; block < end; ++block) least = hn::Min(least, bound(grid.blocks[*block], p));
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
    const Floats nearest = hn::Sqrt(least_of_rows(rows));
    const Ints list = hn::IfThenElseZero(is_listed, hn::ShiftRight<int{kGridLengthBits}>(found));
    const Floats slack =
        hn::BitCast(kTag, hn::GatherIndex(kIntTag, reinterpret_cast<const int32_t*>(grid.lists.data()), list));
    const Floats radius = hn::Sub(hn::Mul(nearest, hn::Set(kTag, 1.0f - kBlockRelativeRounding)), slack);
    hn::StoreU(hn::Max(hn::Zero(kTag), radius), kTag, out + begin);
    if (hn::AllTrue(kIntTag, is_listed)) continue;
    for (size_t i = 0; i < kWidth && begin + i < at.count; ++i)
      if (values[i] < 0)
        out[begin + i] =
            far_radius(grid, static_cast<uint32_t>(values[i]), at.x[begin + i], at.y[begin + i], at.z[begin + i]);
  }
}

void distances(const DistanceBlock* blocks, std::span<const uint32_t> numbers, const std::array<float, 3>& point,
               BlockLanes* squared, float* nearest) {
  const Point p = point_of(point);
  for (size_t begin = 0; begin < numbers.size(); begin += kWidth) {
    Floats rows[kWidth];
    for (size_t i = 0; i < kWidth; ++i) {
      rows[i] = hn::Zero(kTag);
      if (begin + i >= numbers.size()) continue;
      rows[i] = distance(blocks[numbers[begin + i]], p);
      hn::StoreU(rows[i], kTag, squared[begin + i].data());
    }
    hn::StoreU(hn::Sqrt(least_of_rows(rows)), kTag, nearest + begin);
  }
}

HWY_INLINE uint32_t bits_of(hn::Mask<Tag> mask) {
  std::array<uint8_t, 8> bits{};
  hn::StoreMaskBits(kTag, mask, bits.data());
  return bits[0];
}

void within(const BlockLanes* squared, std::span<const LaneLimit> limits, uint32_t* lanes) {
  for (size_t i = 0; i < limits.size(); ++i) {
    const Floats limit = hn::Set(kTag, limits[i].limit * limits[i].limit);
    lanes[i] = bits_of(hn::Le(hn::LoadU(kTag, squared[limits[i].index].data()), limit));
  }
}

uint32_t below(const BoundBlock& block, const std::array<float, 3>& point, float limit) {
  return bits_of(hn::Lt(bound(block, point_of(point)), hn::Set(kTag, limit)));
}

uint32_t least(const BoundBlock& block, const std::array<float, 3>& point) {
  const Floats values = bound(block, point_of(point));
  const intptr_t lane = hn::FindFirstTrue(kTag, hn::Eq(values, hn::MinOfLanes(kTag, values)));
  return lane < 0 ? 0 : static_cast<uint32_t>(lane);  // none, of a point that is not a number
}

}  // namespace barycast::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace barycast {
namespace {

HWY_EXPORT(radii);
HWY_EXPORT(distances);
HWY_EXPORT(within);
HWY_EXPORT(below);
HWY_EXPORT(least);

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

void block_distances(const DistanceBlock* blocks, std::span<const uint32_t> numbers, const std::array<float, 3>& point,
                     BlockLanes* squared, float* nearest) {
  HWY_DYNAMIC_DISPATCH(distances)(blocks, numbers, point, squared, nearest);
}

void lanes_within(const BlockLanes* squared, std::span<const LaneLimit> limits, uint32_t* lanes) {
  HWY_DYNAMIC_DISPATCH(within)(squared, limits, lanes);
}

uint32_t least_bound(const BoundBlock& block, const std::array<float, 3>& point) {
  return HWY_DYNAMIC_DISPATCH(least)(block, point);
}

uint32_t bounds_below(const BoundBlock& block, const std::array<float, 3>& point, float limit) {
  return HWY_DYNAMIC_DISPATCH(below)(block, point, limit);
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
