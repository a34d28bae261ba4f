#pragma once

// The border of the distance engines: closest points on a cage, and radii that are free of it. Engines
// drop in here; answers must not depend on the engine's traversal (ties go to the lowest element).
// Everything is const after construction and safe to call from any number of threads.

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>

#include "cage/cage.h"

namespace barycast {

// A point of the cage.
template <int D>
struct CagePoint {
  double distance;               // from the query
  uint32_t element;              // of Cage::elements(), the lowest of equally near ones
  std::array<double, 4> shares;  // of the element's corners
  Vec<D> point;                  // y = sum share_i corner_i
};

// Positions of walks, in floats, an array for each coordinate (z is 0 in the plane). The arrays are padded: vectors of
// kWalkLanes starting at any multiple of it may be read.
struct WalkPositions {
  const float *x, *y, *z;
  size_t count;
};
inline constexpr size_t kWalkLanes = 16;

template <int D>
Vec<D> position_of(const WalkPositions& at, size_t i) {
  Vec<D> x;
  x[0] = at.x[i];
  x[1] = at.y[i];
  if constexpr (D == 3) x[2] = at.z[i];
  return x;
}

// The radius of a ball for walks: never more than in double.
inline float rounded_down(double radius) {
  return static_cast<float>(radius * (1 - 1e-7));
}

template <int D>
class DistanceIndex {
 public:
  virtual ~DistanceIndex() = default;

  // The closest point, decided in double. within: what its distance is known not to exceed; it may shorten the search
  // and changes no answer.
  virtual CagePoint<D> closest(const Vec<D>& x, double within) const = 0;
  CagePoint<D> closest(const Vec<D>& x) const { return closest(x, std::numeric_limits<double>::infinity()); }

  // Points of the cage, for walks to end at: ends[k] for the position walks[k]. Their distances are more than those of
  // the closest points by `tolerance` at most.
  virtual void near(const WalkPositions& at, std::span<const uint32_t> walks, double tolerance,
                    std::span<CagePoint<D>> ends) const = 0;

  // Radii of balls around positions that contain no point of the cage: never more than the distance; as good as half of
  // it where that is more than some thousandths of the diagonal, but for a few in a hundred positions, beside sharp
  // corners; radii[i] below it may be 0. hints[i] carries what an engine found for the walk's last position to its next
  // one, if it wants to; kNoHint to begin with. Hints never change an answer. `hints` and `radii` are padded as
  // positions are.
  virtual void free_radii(const WalkPositions& at, uint32_t* hints, float* radii) const = 0;

  // The same for one position, as large as the engine can say: what patches deviate from the triangles that stand for
  // them is all that it falls short of the distance by.
  virtual double free_radius(const Vec<D>& x) const = 0;

  virtual size_t bytes() const = 0;
};

inline constexpr uint32_t kNoHint = 0xFFFFFFFFu;

// Whether an index of the cage would be too large. Errors: kResourceExhausted for quads that are too many and too
// twisted.
template <int D>
Status check_distance_index(const Cage<D>& cage);

// Embree's point query over user geometry, for every element kind and both dimensions; Embree proposes
// candidates from padded boxes, our double tests decide. Builds in milliseconds.
// Errors: those of check_distance_index, kInternal when Embree fails.
template <int D>
Result<std::unique_ptr<const DistanceIndex<D>>> make_embree_distance_index(const Cage<D>& cage);

// The engine of choice: an octree over the cage and its surroundings, flattened to lattices of cells that name the
// triangles which may be nearest; radii come in vectors, many walks at a time (grid_builder.h). What lies in no cell,
// or far from everything, is left to Embree. Builds on all threads of the arena, in hundredths of a second for
// hundreds of elements, in some tenths for ten thousand, in seconds for hundreds of thousands.
// Errors: those of make_embree_distance_index.
template <int D>
Result<std::unique_ptr<const DistanceIndex<D>>> make_distance_grid(const Cage<D>& cage);

}  // namespace barycast
