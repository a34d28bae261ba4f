#pragma once

// Builds the tables of a distance grid. The triangles of every level of detail are put into blocks of neighbours
// (neighbour_blocks.h). An octree (in the plane a quadtree) over each lattice then finds, for its cells, the triangles
// that are nearest to some point in them, on the coarsest level that the distance allows (cube_search.h). A cell is cut
// further while they are more than one block holds; its list, and which blocks it shares with its neighbours, is up to
// grid_lists.h. On the threads of the arena; the same tables for any number of them. Cost: ten nanoseconds per cell and
// block, in all some hundredths of a second for hundreds of elements.

#include "query/facet_levels.h"
#include "query/grid_tables.h"

namespace barycast {

// For the facets of a cage in `dimension` dimensions, in the normalized frame.
GridTables build_grid(const FacetLevels& facets, int dimension);

}  // namespace barycast
