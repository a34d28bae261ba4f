#include "query/grid_builder.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <deque>
#include <limits>
#include <map>
#include <memory>

#include "base/tolerances.h"
#include "query/grid_lanes.h"

namespace barycast {
namespace {

// Around the cage's box, in diagonals: walks near the cage from outside find fine cells there.
constexpr double kInnerPadding = 0.02;
// Half the outer lattice's side: beyond kReentryRadius walks are brought back.
constexpr double kOuterReach = kReentryRadius + 0.01;
constexpr uint32_t kOuterCells = 32;
// Cells with more triangles than a block holds are cut, or, where everything is this many of their half diagonals away,
// and larger than the smallest, only know how far it is: their radii are (k - 1) / (k + 1) of the distance at least.
// Less far is enough where triangles are many.
constexpr size_t kTrianglesMany = 6 * kBlockLanes;
constexpr double kFar = 8.0, kFarOfMany = 4.0;
// Where they are too many for lists; radii are half the distance at least. Nearer than this, Embree is asked.
constexpr double kFarLeast = 3.0;
// Facets may deviate by this part of the distance, which the radius then falls short by.
constexpr double kDetail = 0.025;
// Evaluations of blocks, of some ten nanoseconds each, for a lattice: so many for every triangle, within bounds. Cubes
// are cut from large to small: where a cage is too dense for it, all cells stay coarse, and list more.
constexpr uint64_t kEvaluationsLeast = 3'000'000, kEvaluationsMost = 15'000'000, kEvaluationsPerTriangle = 150;
// Blocks for cells of their own: at least, and for every four triangles. Beyond, cells list the blocks of neighbours.
constexpr size_t kOwnBlocksLeast = 400, kOwnBlocksPerFourTriangles = 3;
constexpr size_t kOwnBlocksOfCell = 3;
// Blocks with the cell's nearest triangle that are looked at for one that holds all of the cell's. Its slack may be
// larger by this factor.
constexpr size_t kSharingTries = 24;
constexpr float kSharingSlack = 1.5f;
// Entries of all lists. Beyond, cells know nothing and leave their points to Embree.
constexpr size_t kListedMax = size_t{1} << 22;
static_assert(kListedMax + kGridLengthMax + 1 < kGridFarBit >> kGridLengthBits, "lists begin below the top bit");
// A position may be found in the cell beside its own by rounding: cells cover a little more than themselves.
constexpr double kCellMargin = 1.0 + 1e-4;

std::array<float, 3> in_floats(const Vec<3>& x) {
  return {static_cast<float>(x[0]), static_cast<float>(x[1]), static_cast<float>(x[2])};
}

float rounded_up(double x) {
  return static_cast<float>(x * (1 + 1e-7));
}

// A block near a cell, its distance from the cell's centre, and which of its triangles may be nearest in the cell.
struct Near {
  uint32_t block;
  double distance;
  uint32_t lanes;
};

size_t triangle_count(const std::vector<Near>& near) {
  size_t count = 0;
  for (const Near& n : near) count += static_cast<size_t>(std::popcount(n.lanes));
  return count;
}

class Builder {
 public:
  Builder(const FacetLevels& facets, int dimension) : facets_(facets), dimension_(dimension) {}

  GridTables build() {
    grid_.lists.push_back(0);  // so that there is a first, for lanes without a list
    for (const FacetLevel& level : facets_.levels) make_blocks(level);
    Vec<3> low = facets_.triangles[0].corners[0], high = low;
    for (const FacetTriangle& triangle : facets_.triangles)
      for (const Vec<3>& corner : triangle.corners) {
        low = low.cwiseMin(corner);
        high = high.cwiseMax(corner);
      }
    low.array() -= kInnerPadding;
    high.array() += kInnerPadding;
    const size_t triangles = facets_.levels.front().triangle_count;
    own_blocks_max_ = kOwnBlocksLeast + kOwnBlocksPerFourTriangles * triangles / 4;
    blocks_with_.resize(facets_.triangles.size());
    uint32_t cells = triangles <= 32 ? 32 : triangles <= 1024 ? 64 : 112;
    if (dimension_ == 2) cells *= 2;
    grid_.inner = lattice(low, high, cells);
    grid_.outer = lattice(Vec<3>::Constant(-kOuterReach), Vec<3>::Constant(kOuterReach), kOuterCells);
    fill(grid_.inner);
    fill(grid_.outer);
    grid_.lists.shrink_to_fit();
    grid_.blocks.shrink_to_fit();
    grid_.far.shrink_to_fit();
    return std::move(grid_);
  }

 private:
  static constexpr uint32_t kNoBlock = 0xFFFFFFFFu;
  struct Neighbours {
    DistanceBlock distances;
    uint32_t count;
    double deviation;
    uint32_t bounds;  // the grid's block of the same triangles, once a list has it
  };
  struct OwnBlock {
    std::vector<uint32_t> triangles;  // ascending
    uint64_t signature;
    float slack;
    uint32_t block, list;  // in the grid; the list is of this block alone
  };

  struct Cube {
    uint32_t x, y, z, size;  // in cells
  };

  void make_blocks(const FacetLevel& level) {
    std::vector<uint32_t> triangles(level.triangle_count);
    for (uint32_t i = 0; i < level.triangle_count; ++i) triangles[i] = level.first_triangle + i;
    const auto first = static_cast<uint32_t>(neighbours_.size());
    cut(triangles.data(), triangles.data() + triangles.size());
    level_blocks_.emplace_back();
    for (uint32_t block = first; block < neighbours_.size(); ++block) level_blocks_.back().push_back(block);
  }

  Vec<3> middle(uint32_t triangle) const {
    const auto& corners = facets_.triangles[triangle].corners;
    return (corners[0] + corners[1] + corners[2]) / 3;
  }

  // Neighbours, by cutting at medians.
  void cut(uint32_t* begin, uint32_t* end) {
    const auto count = static_cast<size_t>(end - begin);
    if (count <= kBlockLanes) return add_block({begin, end});
    Vec<3> low = middle(*begin), high = low;
    for (const uint32_t* triangle = begin; triangle != end; ++triangle) {
      low = low.cwiseMin(middle(*triangle));
      high = high.cwiseMax(middle(*triangle));
    }
    Eigen::Index axis = 0;
    (high - low).maxCoeff(&axis);
    // Full blocks on the left.
    uint32_t* const half = begin + (count / 2 + kBlockLanes - 1) / kBlockLanes * kBlockLanes;
    std::nth_element(begin, half, end, [&](uint32_t a, uint32_t b) {
      const double at_a = middle(a)[axis], at_b = middle(b)[axis];
      return at_a < at_b || (at_a == at_b && a < b);
    });
    cut(begin, half);
    cut(half, end);
  }

  // Calls set(lane, triangle) for every lane of a block; those that are left over repeat the first triangle.
  template <class Set>
  static void for_each_lane(std::span<const uint32_t> triangles, const Set& set) {
    for (size_t lane = 0; lane < kBlockLanes; ++lane) set(lane, triangles[lane < triangles.size() ? lane : 0]);
  }
  DistanceBlock distance_block(std::span<const uint32_t> triangles) const {
    DistanceBlock block;
    for_each_lane(triangles, [&](size_t lane, uint32_t triangle) {
      set_lane(block, lane, facets_.triangles[triangle].corners, triangle);
    });
    return block;
  }
  BoundBlock bound_block(std::span<const uint32_t> triangles) const {
    BoundBlock block;
    for_each_lane(triangles, [&](size_t lane, uint32_t triangle) {
      set_lane(block, lane, facets_.triangles[triangle].corners, triangle, dimension_);
    });
    return block;
  }

  double deviation(uint32_t triangle) const { return facets_.deviation[facets_.triangles[triangle].facet]; }

  void add_block(std::span<const uint32_t> triangles) {
    neighbours_.push_back({.distances = distance_block(triangles),
                           .count = static_cast<uint32_t>(triangles.size()),
                           .deviation = 0.0,
                           .bounds = kNoBlock});
    for (const uint32_t triangle : triangles)
      neighbours_.back().deviation = std::max(neighbours_.back().deviation, deviation(triangle));
  }

  GridLattice lattice(const Vec<3>& low, const Vec<3>& high, uint32_t cells) {
    GridLattice result{};
    const Eigen::Index axes = dimension_;
    const double cell = (high - low).head(axes).maxCoeff() / cells;
    result.cell = static_cast<float>(cell);
    result.inverse_cell = static_cast<float>(1.0 / cell);
    uint32_t total = 1;
    for (size_t k = 0; k < 3; ++k) {
      const auto axis = static_cast<Eigen::Index>(k);
      const bool flat = axis >= axes;
      result.low[k] = static_cast<float>(flat ? -0.5 * cell : low[axis]);
      result.count[k] = flat ? 1 : std::min(cells, static_cast<uint32_t>(std::ceil((high - low)[axis] / cell)));
      total *= result.count[k];
    }
    result.first = static_cast<uint32_t>(grid_.cells.size());
    grid_.cells.resize(grid_.cells.size() + total);
    return result;
  }

  // Of every level, the blocks that a cube cannot do without; none on levels too coarse for it.
  using Kept = std::vector<std::vector<uint32_t>>;
  struct Task {
    Cube cube;
    std::shared_ptr<const Kept> blocks;  // of the cube that this one was cut from
  };

  void fill(const GridLattice& lattice) {
    lattice_ = &lattice;
    evaluations_left_ = std::clamp<uint64_t>(kEvaluationsPerTriangle * facets_.levels.front().triangle_count,
                                             kEvaluationsLeast, kEvaluationsMost);
    const uint32_t size = std::bit_ceil(std::max({lattice.count[0], lattice.count[1], lattice.count[2]}));
    tasks_.push_back({{0, 0, 0, size}, std::make_shared<const Kept>(level_blocks_)});
    for (; !tasks_.empty(); tasks_.pop_front()) subdivide(tasks_.front());
  }

  Vec<3> centre_of(const Cube& cube) const {
    const double half = 0.5 * cube.size;
    const auto at = [&](size_t k, uint32_t from) { return lattice_->low[k] + (from + half) * lattice_->cell; };
    return {at(0, cube.x), at(1, cube.y), dimension_ == 2 ? 0.0 : at(2, cube.z)};
  }

  void subdivide(const Task& task) {
    const Cube& cube = task.cube;
    const Vec<3> centre = centre_of(cube);
    const double half = 0.5 * cube.size * lattice_->cell * std::sqrt(dimension_) * kCellMargin;
    Kept kept(task.blocks->size());
    std::vector<Near> near;
    uint64_t next = 0;  // evaluations of a cube cut from this one
    for (size_t level = 0; level < kept.size(); ++level) {
      const std::vector<uint32_t>& blocks = (*task.blocks)[level];
      if (blocks.empty()) continue;
      evaluations_left_ -= std::min<uint64_t>(evaluations_left_, blocks.size());
      near = nearest(blocks, centre, half);
      const bool finest = level + 1 == kept.size();
      if (finest || detailed(near, half)) {
        const size_t triangles = triangle_count(near);
        if (triangles <= kBlockLanes) return set(cube, listed(near));
        const bool many = triangles > kTrianglesMany;
        if ((cube.size > 1 || many) && least_distance(near) > (many ? kFarOfMany : kFar) * half)
          return set(cube, far(centre, near));
      }
      if (!finest && deviation_min(near) > kDetail * (near.front().distance + half)) continue;  // for all of the cube
      for (const Near& n : near) kept[level].push_back(n.block);
      next += near.size();
    }
    const uint32_t children = dimension_ == 2 ? 4 : 8;
    if (cube.size == 1 || evaluations_left_ < children * next) return set(cube, listed_or_far(near, centre, half));
    const auto shared = std::make_shared<const Kept>(std::move(kept));
    const uint32_t step = cube.size / 2;
    for (uint32_t child = 0; child < children; ++child) {
      const Cube part{cube.x + step * (child & 1), cube.y + step * (child >> 1 & 1), cube.z + step * (child >> 2),
                      step};
      if (part.x < lattice_->count[0] && part.y < lattice_->count[1] && part.z < lattice_->count[2])
        tasks_.push_back({part, shared});
    }
  }

  // The blocks with a triangle nearest to some point within `half` of the centre, from near to far.
  std::vector<Near> nearest(const std::vector<uint32_t>& blocks, const Vec<3>& centre, double half) {
    const std::array<float, 3> point = in_floats(centre);
    std::vector<Near> result;
    result.reserve(blocks.size());
    double least = std::numeric_limits<double>::infinity();
    const auto bound_of = [half](double distance) {
      return (distance + 2 * half) * (1 + 2 * double{kBlockRelativeRounding}) + 4 * double{kBlockRounding};
    };
    for (const uint32_t number : blocks) {
      const Neighbours& block = neighbours_[number];
      const double distance = double{nearest_distance(block.distances, point)};
      if (distance - block.deviation > bound_of(least)) continue;  // which only falls
      result.push_back({number, distance, 0});
      least = std::min(least, distance + block.deviation);
    }
    const double bound = bound_of(least);
    for (Near& n : result) {
      const Neighbours& block = neighbours_[n.block];
      if (n.distance - block.deviation > bound) continue;
      n.lanes =
          distances_within(block.distances, point, rounded_up(bound + block.deviation)) & ((1u << block.count) - 1);
    }
    std::erase_if(result, [](const Near& n) { return n.lanes == 0; });
    std::sort(result.begin(), result.end(), [](const Near& a, const Near& b) {
      return a.distance < b.distance || (a.distance == b.distance && a.block < b.block);
    });
    return result;
  }

  double deviation_of(const std::vector<Near>& near) const {
    double deviation = 0.0;
    for (const Near& n : near) deviation = std::max(deviation, neighbours_[n.block].deviation);
    return deviation;
  }

  double deviation_min(const std::vector<Near>& near) const {
    double deviation = std::numeric_limits<double>::infinity();
    for (const Near& n : near) deviation = std::min(deviation, neighbours_[n.block].deviation);
    return deviation;
  }

  // Whether these blocks follow the cage as closely as the distance asks for.
  bool detailed(const std::vector<Near>& near, double half) const {
    return deviation_of(near) <= kDetail * std::max(0.0, near.front().distance - half);
  }

  double least_distance(const std::vector<Near>& near) const {
    double least = std::numeric_limits<double>::infinity();
    for (const Near& n : near) least = std::min(least, n.distance - neighbours_[n.block].deviation);
    return least * (1 - double{kBlockRelativeRounding}) - double{kBlockRounding};
  }

  void set(const Cube& cube, uint32_t value) {
    const GridLattice& l = *lattice_;
    const auto end = [&](uint32_t from, size_t k) { return std::min(from + cube.size, l.count[k]); };
    for (uint32_t z = cube.z; z < end(cube.z, 2); ++z)
      for (uint32_t y = cube.y; y < end(cube.y, 1); ++y) {
        const auto row = grid_.cells.begin() + l.first + (z * l.count[1] + y) * l.count[0];
        std::fill(row + cube.x, row + end(cube.x, 0), value);
      }
  }

  uint32_t far(const Vec<3>& centre, const std::vector<Near>& near) {
    grid_.far.push_back({in_floats(centre), static_cast<float>(least_distance(near))});
    return kGridFarBit | static_cast<uint32_t>(grid_.far.size() - 1);
  }

  // A list for these triangles: of blocks of their own where few are enough, of the blocks that they are neighbours in
  // otherwise. kNoCell where they are too many.
  uint32_t listed(const std::vector<Near>& near) {
    if (grid_.lists.size() > kListedMax) return kNoCell;
    std::vector<uint32_t> blocks;
    float slack = 0.0f;
    if (triangle_count(near) <= kBlockLanes) {
      triangles_.clear();
      append_triangles(near, triangles_);
      if (const OwnBlock* const own = own_block(triangles_)) return own->list;
    } else if (own_blocks(near, blocks, slack)) {
      return list_of(blocks, slack);
    }
    if (near.size() > kGridLengthMax) return kNoCell;
    blocks.clear();
    for (const Near& n : near) {
      uint32_t& block = neighbours_[n.block].bounds;
      if (block == kNoBlock) block = new_block(triangles_of(n.block));
      blocks.push_back(block);
    }
    return list_of(blocks, static_cast<float>(deviation_of(near)) + kBlockRounding);
  }

  // Where the triangles are too many for a list, how far they are will do, unless they are in the cell or next to it.
  uint32_t listed_or_far(const std::vector<Near>& near, const Vec<3>& centre, double half) {
    const uint32_t value = listed(near);
    return value == kNoCell && least_distance(near) > kFarLeast * half ? far(centre, near) : value;
  }

  void append_triangles(const std::vector<Near>& near, std::vector<uint32_t>& triangles) const {
    for (const Near& n : near)
      for (uint32_t lanes = n.lanes; lanes != 0; lanes &= lanes - 1)
        triangles.push_back(triangles_of(n.block)[static_cast<size_t>(std::countr_zero(lanes))]);
  }

  // The same for the same blocks, whatever their order.
  uint32_t list_of(const std::vector<uint32_t>& blocks, float slack) {
    std::vector<uint32_t> key = blocks;
    std::sort(key.begin(), key.end());
    const auto [at, is_new] = lists_.try_emplace(std::move(key), 0);
    if (is_new) at->second = new_list(blocks, slack);
    return at->second;
  }

  uint32_t new_list(std::span<const uint32_t> blocks, float slack) {
    const auto begin = static_cast<uint32_t>(grid_.lists.size());
    grid_.lists.push_back(std::bit_cast<uint32_t>(slack));
    grid_.lists.insert(grid_.lists.end(), blocks.begin(), blocks.end());
    return begin << kGridLengthBits | static_cast<uint32_t>(blocks.size());
  }

  std::span<const uint32_t> triangles_of(uint32_t neighbours) const {
    return {neighbours_[neighbours].distances.triangle.data(), neighbours_[neighbours].count};
  }

  uint32_t new_block(std::span<const uint32_t> triangles) {
    grid_.blocks.push_back(bound_block(triangles));
    return static_cast<uint32_t>(grid_.blocks.size() - 1);
  }

  // Blocks with these triangles, and perhaps others. False: there are too many, or no room for more blocks.
  bool own_blocks(const std::vector<Near>& near, std::vector<uint32_t>& blocks, float& slack) {
    if (triangle_count(near) > kOwnBlocksOfCell * kBlockLanes) return false;
    std::vector<uint32_t> triangles;
    append_triangles(near, triangles);
    for (size_t first = 0; first < triangles.size(); first += kBlockLanes) {
      const OwnBlock* const own =
          own_block(std::span(triangles).subspan(first, std::min(kBlockLanes, triangles.size() - first)));
      if (own == nullptr) return false;
      blocks.push_back(own->block);
      slack = std::max(slack, own->slack);
    }
    return true;
  }

  // A bit for every triangle, the same for some: sets that hold others have all of their bits.
  static uint64_t signature(std::span<const uint32_t> triangles) {
    uint64_t bits = 0;
    for (const uint32_t triangle : triangles) bits |= uint64_t{1} << (triangle % 64);
    return bits;
  }

  // Sorts the triangles. None: there is no room for more blocks.
  const OwnBlock* own_block(std::span<uint32_t> triangles) {
    std::sort(triangles.begin(), triangles.end());
    float slack = 0.0f;
    for (const uint32_t triangle : triangles) slack = std::max(slack, static_cast<float>(deviation(triangle)));
    slack += kBlockRounding;
    const uint64_t bits = signature(triangles);
    const std::vector<uint32_t>& candidates = blocks_with_[triangles.front()];
    for (size_t tries = 0; tries < std::min(kSharingTries, candidates.size()); ++tries) {
      const OwnBlock& own = own_blocks_[candidates[candidates.size() - 1 - tries]];
      if ((bits & ~own.signature) == 0 && own.slack <= kSharingSlack * slack &&
          std::includes(own.triangles.begin(), own.triangles.end(), triangles.begin(), triangles.end()))
        return &own;
    }
    if (own_blocks_.size() >= own_blocks_max_) return nullptr;
    const auto number = static_cast<uint32_t>(own_blocks_.size());
    for (const uint32_t triangle : triangles) blocks_with_[triangle].push_back(number);
    const uint32_t block = new_block(triangles);
    const uint32_t list = new_list(std::array{block}, slack);
    own_blocks_.push_back({{triangles.begin(), triangles.end()}, bits, slack, block, list});
    return &own_blocks_.back();
  }

  const FacetLevels& facets_;
  const int dimension_;
  std::vector<Neighbours> neighbours_;
  std::vector<std::vector<uint32_t>> level_blocks_;  // of neighbours
  std::map<std::vector<uint32_t>, uint32_t> lists_;  // blocks, ascending, to their list
  std::vector<uint32_t> triangles_;                  // of the cell at hand
  std::vector<OwnBlock> own_blocks_;
  std::vector<std::vector<uint32_t>> blocks_with_;  // own blocks, by triangle
  size_t own_blocks_max_ = 0;
  const GridLattice* lattice_ = nullptr;
  std::deque<Task> tasks_;
  uint64_t evaluations_left_ = 0;
  GridTables grid_;
};

}  // namespace

GridTables build_grid(const FacetLevels& facets, int dimension) {
  return Builder(facets, dimension).build();
}

}  // namespace barycast
