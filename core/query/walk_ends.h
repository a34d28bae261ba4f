#pragma once

// Where walks end, for many of them at a time, in vectors of the processor's width (AVX2 or AVX-512, chosen when the
// program runs; the same bits for both): the nearest triangle of a distance grid, the closest point on it, and on the
// patch that it stands for. In floats: parameters only, from which doubles make the point. Whatever a point's
// parameters are, it is a point of the cage with the basis that belongs to it; how near it is, doubles have to check.

#include <cstdint>
#include <vector>

#include "cage/cage.h"
#include "query/distance_index.h"
#include "query/facet_levels.h"
#include "query/grid_tables.h"

namespace barycast {

// Triangles and patches of a cage in space as vector code reads them.
struct EndTables {
  // A corner and two edges; then the patch's parameters there, as functions of the shares of the second and third
  // corner: u = u0 + u2 second + u3 third, and v likewise. u2 is the side of the window.
  struct Triangle {
    float corner[3], second[3], third[3];
    float u0, u2, u3, v0, v2, v3;
    uint32_t patch;  // an element; or one of the two below
  };
  // Floats and indices of a table are gathered alike.
  static_assert(sizeof(Triangle) == 16 * sizeof(float));
  // q(u, v) = origin + u a + v b + u v twist
  struct Patch {
    float origin[3], a[3], b[3], twist[3];
  };
  static constexpr uint32_t kNoPatch = 0xFFFFFFFFu;  // the triangle is an element itself
  static constexpr uint32_t kNoEnd = 0xFFFFFFFEu;    // its shares say too little of a point on its facet

  std::vector<Triangle> triangles;
  std::vector<Patch> patches;  // by element; none where no element is a quad
  size_t bytes() const { return triangles.capacity() * sizeof(Triangle) + patches.capacity() * sizeof(Patch); }
};

EndTables make_end_tables(const Cage<3>& cage, const FacetLevels& facets);

struct WalkEnd {
  uint32_t triangle;    // kNoTriangle: the position is in no cell with a list
  float first, second;  // of an element: the shares of its second and third corner; of a patch: u, v
  float bound;          // no triangle is nearer than that, but for rounding
  float slack;          // of the cell's list
};
inline constexpr uint32_t kNoTriangle = 0xFFFFFFFFu;

// The ends of walks at the positions of the given indices.
void find_ends(const GridTables& grid, const EndTables& tables, const WalkPositions& at, const uint32_t* walks,
               size_t count, WalkEnd* ends);

}  // namespace barycast
