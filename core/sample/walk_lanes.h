#pragma once

// What walks on spheres do at every step, for many walks at a time, in vectors of the processor's width (AVX2 or
// AVX-512, chosen when the program runs). Results are the same bits for both. Arrays are padded to kWalkLanes.

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "base/random.h"

namespace barycast {

// Walks, one array for each of their properties, in floats: they decide where samples are taken, not their values.
struct WalkArrays {
  float *x, *y, *z;  // z is 0 in the plane
  float* radius;     // free of the cage
  uint32_t* walk;    // its number among the walks of its query
  uint32_t* hint;    // of the distance engine
};

// The walks of a query, in a row, and the numbers that their lattice is shifted by.
struct LatticeWalks {
  size_t begin, count;
  std::array<uint32_t, 2> shift;
  enum Order { kAlongCurve, kInOrder } order;
  uint32_t first_rank = 0;  // of walks in order
};

// Workspace, of as many as there are walks, padded to twice kWalkLanes more.
struct CurveKeys {
  uint32_t *fine, *rank;
  int16_t* coarse;
};

// Numbers for a step of all walks, 32 bits each: those of a query are ranked by their places along a space-filling
// curve [Morton 1966], equal ones in their order, or all in their order, and rank r gets point r of an additive lattice
// [Roberts 2018: the generalized golden ratio], in one or two dimensions, shifted. Few walks are ranked by counting
// those before each, which costs the square of their number and is done with keys of 15 bits, two to a lane; more than
// this by sorting keys of 30 bits.
inline constexpr size_t kWalksCountedMax = 256;
void lattice_numbers(const WalkArrays& walks, std::span<const LatticeWalks> queries, int dimensions,
                     const CurveKeys& keys, uint32_t* first, uint32_t* second);

// Numbers i: those of `random` for walk[i] at this step.
void independent_numbers(const QueryRandom& random, const uint32_t* walk, size_t count, uint32_t step, uint32_t* first,
                         uint32_t* second);

// Moves every walk by its radius, in the direction that its numbers give: uniform over the sphere, or over the circle
// in the plane. Walks beyond `reach` stay; their indices are written to `beyond`. Returns how many.
size_t move_walks(const WalkArrays& walks, const uint32_t* first, const uint32_t* second, size_t count, int dimension,
                  float reach, uint32_t* beyond);

// Writes the indices of walks with a radius below `limit`; returns how many.
size_t find_arriving(const float* radius, size_t count, float limit, uint32_t* indices);

// Keeps the walks with kept[i] != 0, in order; returns how many.
size_t keep_walks(const WalkArrays& walks, const uint32_t* kept, size_t count);

}  // namespace barycast
