#pragma once

// What a cell of a distance grid, or a cube of them, has to know: the triangles that are nearest to some point in it,
// on the coarsest level of detail that the distance allows, or how far all of them are, or that it has to be cut. A
// function of the cube and of its parent's blocks alone, so that threads may search many cubes at a time. Cost: eight
// nanoseconds per block of the parent that may be near.

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "query/grid_lanes.h"
#include "query/neighbour_blocks.h"

namespace barycast {

// A block near a cube, its distance from the cube's centre, and which of its triangles may be nearest in the cube.
struct Near {
  uint32_t block;
  float distance;
  uint32_t lanes;
};

// At most a block of triangles, as they are looked up among those of other cells.
struct TriangleSet {
  uint64_t signature;  // a bit for every triangle, the same for some: sets that hold others have all of their bits
  float slack;
  uint32_t first;  // the least one
  uint32_t count;
  std::array<uint32_t, kBlockLanes> triangle;
  std::span<const uint32_t> triangles() const { return {triangle.data(), count}; }
};

// Lists of at most so many triangles are of blocks of the cell's own.
inline constexpr size_t kOwnBlocksOfCell = 3;

// Of every level, blocks and their distances from the centre of the cube that was cut. The first of a level is nearest;
// levels too coarse for the cube have none.
struct KeptBlocks {
  std::span<const uint32_t> blocks;
  std::span<const float> distances;
  std::array<uint32_t, kFacetLevelsMax> level_end;
};

struct CubeQuery {
  Vec<3> centre;
  double half;        // diagonal, and a little more
  bool is_cell;       // not to be cut
  uint64_t kept_max;  // nor is a cube that keeps more blocks
};

struct CubeFound {
  enum class Kind : uint8_t {
    kListed,  // by a list of its triangles
    kFar,     // by its distance
    kOpen     // to be cut, or listed where that is no longer possible
  };
  Kind kind = Kind::kOpen;
  bool is_prepared = false;     // by prepare_list()
  bool is_outside = false;      // far enough to be known by its distance where triangles are too many for a list
  float least_distance = 0.0f;  // of all triangles from the centre, at least
  uint32_t evaluations = 0;     // of blocks
  // Into CubesFound::near: of every level those that cubes cut from this one need; from own_begin on, the cube's own.
  uint32_t near_begin = 0, own_begin = 0, near_end = 0;
  std::array<uint32_t, kFacetLevelsMax> level_end{};
  uint32_t sets_begin = 0, sets_end = 0;  // into CubesFound::sets; none where the triangles are too many

  uint32_t kept() const { return near_end - near_begin; }
};

// Of some cubes.
struct CubesFound {
  std::vector<CubeFound> cubes;
  std::vector<Near> near;
  std::vector<TriangleSet> sets;
  void clear();
  std::span<Near> own(const CubeFound& found) {
    return std::span(near).subspan(found.own_begin, found.near_end - found.own_begin);
  }
};

// From near to far.
void order(std::span<Near> near);

// Makes the sets of a cube, and puts its blocks in order where they are more than one.
void prepare_list(CubeFound& found, const NeighbourBlocks& blocks, CubesFound& out);

std::array<float, 3> in_floats(const Vec<3>& x);

// For one thread.
class CubeSearch {
 public:
  explicit CubeSearch(const NeighbourBlocks& blocks) : blocks_(blocks) {}

  // Appends what was found.
  void search(const CubeQuery& cube, const KeptBlocks& kept, CubesFound& out);

 private:
  // Of some blocks near a cube: distances, those less the deviations, the deviations; and how many triangles.
  struct Extremes {
    double nearest, least, deviation_least, deviation_most;
    uint32_t triangles;
  };

  Extremes append_nearest(std::span<const uint32_t> blocks, std::span<const float> distances, const CubeQuery& cube,
                          std::vector<Near>& near);
  void measure(std::span<const uint32_t> blocks, std::span<const float> distances, const CubeQuery& cube);
  double least_sum() const;

  const NeighbourBlocks& blocks_;
  // Reused. Of blocks that were measured: squared distances of their triangles, those of the nearest ones, deviations.
  std::vector<uint32_t> measured_;
  std::vector<BlockLanes> squared_;
  std::vector<float> distance_;
  std::vector<double> deviation_;
  // Of those that are near.
  std::vector<LaneLimit> limits_;
  std::vector<uint32_t> lanes_;
};

}  // namespace barycast
