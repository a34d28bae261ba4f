#pragma once

// What a binding would cost, before it exists: decided from sizes and options alone, so that a service can
// say it and refuse before work starts. Pure functions, some nanoseconds each.
//
// Exact are the sizes of what the binding keeps for every point, and of vectors that grow by doubling. Two
// things depend on the data: how many control vertices a row touches, and how far the factor of the
// smoothing matrix fills in. The estimate takes what points in and around the cage and meshes that are
// surfaces show (measured: tests/core/cost_test.cpp, within 25 %); the bound takes the worst of the first,
// all that samples could touch, twice the fill of a surface, and a tenth more of everything. Of a prediction, which is
// made where the cage's index does not hold it yet, the estimate takes one: for the inside of a closed cage; the bound
// takes the other as well, for points outside. To a target error, both take all the rounds that there may be. With
// tables, both take what threads need to make them, and that every point walks as well; tables that are kept are the
// index's.

#include <cstdint>

#include "bind/options.h"

namespace barycast {

// How large a binding would be. `stencil_max`: most control vertices behind one point of the cage, 4 unless
// it has larger polygons. Of the cage, predictions alone ask for elements, triangles (a quad is two) and whether it is
// closed.
struct BindingSize {
  int dimension = 3;
  uint64_t control_vertices = 0;
  uint64_t stencil_max = 4;
  uint64_t elements = 1;
  uint64_t triangles = 1;
  bool closed = true;
  uint64_t points = 0;
  uint64_t faces = 0;
  uint64_t face_corners = 0;
  uint64_t block_rows = 4096;
  uint64_t threads = 1;
};

// Peak of a binding's working memory, from its query input to its last block of rows; not the cage's index,
// but for a prediction.
uint64_t estimate_memory_bytes(const BindingSize& size, const ResolvedOptions& options);
// At least what it will use, for admission; where faces connect the points in no surface-like way the factor
// has a bound of its own, see smooth/heat.h.
uint64_t bound_memory_bytes(const BindingSize& size, const ResolvedOptions& options);

// Walks or rays of a point at the most, and of all. Rays come in lines of two, an even number per point inside the
// cage's enclosing ball; with the paper preset there are fewer where they have several hits, with a target error where
// it is met.
uint64_t samples_most(const ResolvedOptions& options);
uint64_t estimate_samples(const BindingSize& size, const ResolvedOptions& options);

// Entries of all rows, as expected; exact where nothing is pruned.
uint64_t estimate_entries(const BindingSize& size, const ResolvedOptions& options);

}  // namespace barycast
