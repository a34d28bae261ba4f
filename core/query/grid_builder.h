#pragma once

// Builds the tables of a distance grid. The triangles of every level of detail are put into blocks of neighbours. An
// octree (in the plane a quadtree) over each lattice then finds, for its cells, the blocks that hold the triangle
// nearest to some point in them, on the coarsest level that the distance allows. A cell is cut further while it has
// more than two blocks. Cost: 15 nanoseconds per cell and block, in all some milliseconds for hundreds of elements.

#include "query/facet_levels.h"
#include "query/grid_tables.h"

namespace barycast {

// For the facets of a cage in `dimension` dimensions, in the normalized frame.
GridTables build_grid(const FacetLevels& facets, int dimension);

}  // namespace barycast
