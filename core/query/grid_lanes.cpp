#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "query/grid_lanes.cpp"  // this file, once for every processor
#include "query/grid_lanes.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
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

// Table indices of the cells of positions.
HWY_INLINE Ints cells_of(const GridTables& grid, const Point& p) {
  Ints inner, outer;
  const auto in_inner = lookup(grid.inner, p, inner);
  if (hn::AllTrue(kTag, in_inner)) return inner;
  const auto in_outer = lookup(grid.outer, p, outer);
  const Ints none = hn::Set(kIntTag, static_cast<int32_t>(grid.cells.size() - 1));
  return hn::IfThenElse(hn::RebindMask(kIntTag, in_inner), inner,
                        hn::IfThenElse(hn::RebindMask(kIntTag, in_outer), outer, none));
}

// Some positions, and what is known of each. What a position needs is found in passes over all of them, and how long
// its list is decides nothing but what the next pass has to do: branches that nothing foretells, and chains of lookups,
// were a third of the time.
struct Tile {
  static constexpr size_t kPositions = 64, kAtATime = kGridListsPadding;
  HWY_ALIGN int32_t cell[kPositions];  // its value
  HWY_ALIGN float slack[kPositions];
  HWY_ALIGN float squares[kPositions][kWidth];  // the least bounds so far, of every lane
  // Blocks beyond the first of a list, and whose they are.
  uint32_t further[kPositions * kGridLengthMax + kAtATime];
  uint8_t further_of[kPositions * kGridLengthMax + kAtATime];
  size_t further_count;
};

HWY_INLINE size_t padded(size_t count) {
  return (count + kWidth - 1) / kWidth * kWidth;
}

// Pointers are copied in what follows: what is written may be anything, for all that the compiler knows.

// Returns whether all cells have lists.
HWY_INLINE bool find_cells(const GridTables& grid, const WalkPositions at, Tile& tile) {
  const uint32_t *const cells = grid.cells.data(), *const lists = grid.lists.data();
  for (size_t i = 0; i < at.count; i += kWidth) {
    const Point p{hn::LoadU(kTag, at.x + i), hn::LoadU(kTag, at.y + i), hn::LoadU(kTag, at.z + i)};
    hn::Store(cells_of(grid, p), kIntTag, tile.cell + i);
  }
  uint8_t longer[Tile::kPositions];
  size_t longer_count = 0;
  uint32_t all = 0;
  for (size_t i = 0; i < padded(at.count); ++i) {
    const uint32_t value = cells[tile.cell[i]];
    tile.cell[i] = static_cast<int32_t>(value);
    all |= value;
    longer[longer_count] = static_cast<uint8_t>(i);
    longer_count += static_cast<size_t>((value & kGridFarBit) == 0 && grid_list_length(value) > 1);
  }
  size_t count = 0;
  for (size_t k = 0; k < longer_count; ++k) {
    const auto value = static_cast<uint32_t>(tile.cell[longer[k]]);
    const uint32_t* const blocks = lists + grid_list_begin(value) + 2;
    const size_t length = grid_list_length(value) - 1;
    for (size_t j = 0; j < length; j += Tile::kAtATime) {
      std::memcpy(tile.further + count + j, blocks + j, Tile::kAtATime * sizeof(uint32_t));
      std::memset(tile.further_of + count + j, longer[k], Tile::kAtATime);
    }
    count += length;
  }
  tile.further_count = count;
  return (all & kGridFarBit) == 0;
}

HWY_INLINE void find_bounds(const GridTables& grid, const WalkPositions at, Tile& tile) {
  const uint32_t* const lists = grid.lists.data();
  const BoundBlock* const blocks = grid.blocks.data();
  const auto bound_at = [&](uint32_t block, size_t i) HWY_ATTR {
    return bound(blocks[block], {hn::Set(kTag, at.x[i]), hn::Set(kTag, at.y[i]), hn::Set(kTag, at.z[i])});
  };
  for (size_t i = 0; i < padded(at.count); ++i) {
    const uint32_t* const list = lists + (tile.cell[i] < 0 ? 0 : grid_list_begin(static_cast<uint32_t>(tile.cell[i])));
    tile.slack[i] = std::bit_cast<float>(list[0]);
    hn::Store(bound_at(list[1], i), kTag, tile.squares[i]);
  }
  for (size_t k = 0, count = tile.further_count; k < count; ++k) {
    const size_t i = tile.further_of[k];
    float* const least = tile.squares[i];
    hn::Store(hn::Min(hn::Load(kTag, least), bound_at(tile.further[k], i)), kTag, least);
  }
}

HWY_INLINE void write_radii(const Tile& tile, size_t count, float* radius) {
  for (size_t i = 0; i < count; i += kWidth) {
    Floats rows[kWidth];
    for (size_t k = 0; k < kWidth; ++k) rows[k] = hn::Load(kTag, tile.squares[i + k]);
    const Floats nearest = hn::Mul(hn::Sqrt(least_of_rows(rows)), hn::Set(kTag, 1.0f - kBlockRelativeRounding));
    hn::StoreU(hn::Max(hn::Zero(kTag), hn::Sub(nearest, hn::Load(kTag, tile.slack + i))), kTag, radius + i);
  }
}

bool radii(const GridTables& grid, const WalkPositions& at, float* out) {
  Tile tile;
  bool all_in_grid = true;
  for (size_t begin = 0; begin < at.count; begin += Tile::kPositions) {
    const WalkPositions some{at.x + begin, at.y + begin, at.z + begin, std::min(Tile::kPositions, at.count - begin)};
    const bool all_listed = find_cells(grid, some, tile);
    find_bounds(grid, some, tile);
    write_radii(tile, some.count, out + begin);
    if (all_listed) continue;
    for (size_t i = 0; i < some.count; ++i) {
      if (tile.cell[i] >= 0) continue;
      float& radius = out[begin + i];
      radius = far_radius(grid, static_cast<uint32_t>(tile.cell[i]), some.x[i], some.y[i], some.z[i]);
      all_in_grid &= radius != kNotInGrid;
    }
  }
  return all_in_grid;
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

bool grid_radii(const GridTables& grid, const WalkPositions& at, float* radii_out) {
  return HWY_DYNAMIC_DISPATCH(radii)(grid, at, radii_out);
}

uint32_t grid_cell(const GridTables& grid, const std::array<float, 3>& point) {
  uint32_t cell = 0;
  if (find(grid.inner, point, cell) || find(grid.outer, point, cell)) return grid.cells[cell];
  return kNoCell;
}

}  // namespace barycast
#endif
