#pragma once

// Distances from blocks of triangles, for many points at a time or for one, in vectors of the processor's width
// (AVX2 or AVX-512, chosen when the program runs). Results are the same bits for both: a lane never sees its
// neighbours but in minima.

#include <cstddef>
#include <span>

#include "query/distance_index.h"
#include "query/grid_tables.h"

namespace barycast {

// Of some blocks, squared distances from a point to their triangles, and of each block the distance to the nearest one.
// `nearest` has room for a multiple of kBlockLanes.
void block_distances(const DistanceBlock* blocks, std::span<const uint32_t> numbers, const std::array<float, 3>& point,
                     BlockLanes* squared, float* nearest);
// Of some of them, a bit for every lane that is no farther than the limit.
struct LaneLimit {
  uint32_t index;
  float limit;
};
void lanes_within(const BlockLanes* squared, std::span<const LaneLimit> limits, uint32_t* lanes);

// The lane of the least bound, the first of equal ones.
uint32_t least_bound(const BoundBlock& block, const std::array<float, 3>& point);
// A bit for every lane whose squared bound is below `limit`.
uint32_t bounds_below(const BoundBlock& block, const std::array<float, 3>& point, float limit);

// Radii around the positions that are free of the cage, as DistanceIndex::free_radii says; kNotInGrid for positions in
// no lattice. Returns whether all are in one.
inline constexpr float kNotInGrid = -1.0f;
bool grid_radii(const GridTables& grid, const WalkPositions& at, float* radii);

// The cell's value for one point, or kNoCell where it is in no lattice.
uint32_t grid_cell(const GridTables& grid, const std::array<float, 3>& point);

}  // namespace barycast
