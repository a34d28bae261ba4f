#pragma once

// The lists of blocks of a distance grid, made one cell after the other. Cells share a block where it holds the
// triangles of both; where too many triangles meet, or memory is at its end, cells list the blocks of neighbours
// instead. Which blocks there are depends on the order of the cells. Cost: some ten nanoseconds for a cell.

#include <cstdint>
#include <span>
#include <vector>

#include "query/cube_search.h"
#include "query/grid_tables.h"

namespace barycast {

class GridLists {
 public:
  GridLists(const NeighbourBlocks& neighbours, size_t triangle_count, GridTables& grid);

  // The value of a cell with these blocks near, and sets of their triangles, if any, as prepare_list() leaves them.
  // kNoCell where they are too many. May put the blocks in order.
  uint32_t list(std::span<Near> near, std::span<const TriangleSet> sets);

  // Makes the blocks of all lists, on the threads of the arena.
  void make_blocks(const FacetLevels& facets, int dimension);

 private:
  using BlockTriangles = std::array<uint32_t, kBlockLanes>;  // those that are left over repeat the first
  struct OwnBlock {
    float slack;
    uint32_t block, list;  // in the grid; the list is of this block alone
  };
  // What of an own block is looked at most.
  struct Candidate {
    uint64_t signature;
    float slack;
    uint32_t own;
  };
  // A list by its blocks, ascending; no list where it has none.
  struct KnownList {
    uint64_t hash;
    uint32_t key_begin, key_size;  // in keys_
    uint32_t list;
  };
  bool own_blocks(std::span<const TriangleSet> sets, float& slack);
  const OwnBlock* own_block(const TriangleSet& set);
  uint32_t new_block(std::span<const uint32_t> triangles);
  uint32_t list_of(float slack);
  KnownList& known(uint64_t hash);
  void grow_known();
  uint32_t new_list(std::span<const uint32_t> blocks, float slack);

  const NeighbourBlocks& neighbours_;
  GridTables& grid_;
  const size_t own_blocks_max_;
  std::vector<BlockTriangles> blocks_;
  std::vector<uint32_t> bounds_;  // by block of neighbours, the grid's block of the same triangles
  std::vector<OwnBlock> own_blocks_;
  std::vector<std::vector<Candidate>> blocks_with_;  // by triangle
  std::vector<KnownList> known_;                     // a hash table, at most half full
  size_t known_count_ = 0;
  std::vector<uint32_t> keys_;
  std::vector<uint32_t> list_, key_;  // of the cell at hand: blocks from near to far, and ascending
};

}  // namespace barycast
