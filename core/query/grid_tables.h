#pragma once

// What a distance grid looks up: lattices of cells, and for every cell the blocks of triangles that hold the nearest
// one to any point in it, mostly a single one, or how far all of them are. Plain data, read by the vector code of
// grid_lanes.h; made by grid_builder.h.

#include <array>
#include <bit>
#include <cstdint>
#include <span>
#include <vector>

#include "query/triangle_block.h"

namespace barycast {

// Cells of a box, x fastest. Cell 0 of the lattice is cell `first` of the table.
struct GridLattice {
  std::array<float, 3> low;
  float cell, inverse_cell;
  std::array<uint32_t, 3> count;
  uint32_t first;
};

// A cell far from everything, for its size: no triangle is nearer to its centre than this.
struct GridFar {
  std::array<float, 3> centre;
  float distance;
};

// The value of a cell: where its list of blocks begins, and how many they are; or, with the top bit, the index of a
// GridFar; or kNoCell, where nothing is known.
inline constexpr uint32_t kGridFarBit = 0x80000000u;
inline constexpr uint32_t kNoCell = 0xFFFFFFFFu;
inline constexpr uint32_t kGridLengthBits = 6;
inline constexpr uint32_t kGridLengthMax = (1u << kGridLengthBits) - 1;

// Vectors of so many block numbers may be read.
inline constexpr size_t kGridListsPadding = 8;

constexpr uint32_t grid_list_begin(uint32_t cell) {
  return cell >> kGridLengthBits;
}
constexpr uint32_t grid_list_length(uint32_t cell) {
  return cell & kGridLengthMax;
}

struct GridTables {
  // The inner one, around the cage, is looked at first; the outer one is coarse and holds all that walks reach.
  GridLattice inner, outer;
  std::vector<uint32_t> cells;  // those of the lattices; the last one, kNoCell, is for positions in neither
  std::vector<BoundBlock> blocks;
  // Lists: a float's bits, by how much elements may be nearer than the triangles of the blocks, rounding included; then
  // indices of blocks, nearest first. The first list is that of positions whose cell has none; there is padding at the
  // end.
  std::vector<uint32_t> lists;
  std::vector<GridFar> far;

  float slack(uint32_t cell) const { return std::bit_cast<float>(lists[grid_list_begin(cell)]); }
  std::span<const uint32_t> blocks_of(uint32_t cell) const {
    return std::span(lists).subspan(grid_list_begin(cell) + 1, grid_list_length(cell));
  }
  size_t bytes() const {
    return sizeof(*this) + cells.capacity() * sizeof(uint32_t) + blocks.capacity() * sizeof(BoundBlock) +
           lists.capacity() * sizeof(uint32_t) + far.capacity() * sizeof(GridFar);
  }
};

}  // namespace barycast
