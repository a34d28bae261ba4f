#pragma once

// Builds the tables of a distance grid. The triangles of every level of detail are put into blocks of neighbours. An
// octree (in the plane a quadtree) over each lattice then finds, for its cells, the triangles that are nearest to some
// point in them, on the coarsest level that the distance allows. A cell is cut further while they are more than one
// block holds; neighbouring cells share a block where it holds the triangles of both. Where too many triangles meet,
// or memory is at its end, cells list the blocks of neighbours instead. Cost: 20 nanoseconds per cell and block, in
// all some milliseconds for hundreds of elements.

#include "query/facet_levels.h"
#include "query/grid_tables.h"

namespace barycast {

// For the facets of a cage in `dimension` dimensions, in the normalized frame.
GridTables build_grid(const FacetLevels& facets, int dimension);

}  // namespace barycast
