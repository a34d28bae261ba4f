#pragma once

// The triangles of all levels of detail in blocks of neighbours: what the build of a distance grid measures cubes
// against. A median cut, full blocks first: some hundred nanoseconds per triangle.

#include <cstdint>
#include <span>
#include <vector>

#include "query/facet_levels.h"
#include "query/triangle_block.h"

namespace barycast {

struct NeighbourBlocks {
  // By block; apart from each other, since searches read a few bytes of most blocks and all of some.
  std::vector<DistanceBlock> distances;
  std::vector<uint32_t> count;             // of triangles; the lanes beyond repeat the first
  std::vector<double> deviation;           // of their facets, at most
  std::vector<uint32_t> level_end;         // by level, the blocks before its end; levels follow each other
  std::vector<double> triangle_deviation;  // by triangle

  std::span<const uint32_t> triangles(uint32_t block) const { return {distances[block].triangle.data(), count[block]}; }
};

NeighbourBlocks make_neighbour_blocks(const FacetLevels& facets);

}  // namespace barycast
