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
// Cells with more blocks are cut, or, where everything is this many of their half diagonals away, only know how far it
// is: their radii are (k - 1) / (k + 1) of the distance at least. Less far is enough where the list would be long.
constexpr size_t kBlocksEnough = 2, kBlocksMany = 6;
constexpr double kFar = 8.0, kFarOfMany = 4.0;
// Facets may deviate by this part of the distance, which the radius then falls short by.
constexpr double kDetail = 0.025;
// Evaluations of blocks, of some ten nanoseconds each, for a lattice. Cubes are cut from large to small: where a cage
// is too dense for it, all cells stay coarse, and list more.
constexpr uint64_t kEvaluationsMax = 3'000'000;
// Entries of all lists. Beyond, cells know nothing and leave their points to Embree.
constexpr size_t kListedMax = size_t{1} << 22;
static_assert(kListedMax + kGridLengthMax + 1 < kGridFarBit >> kGridLengthBits, "lists begin below the top bit");
// A position may be found in the cell beside its own by rounding: cells cover a little more than themselves.
constexpr double kCellMargin = 1.0 + 1e-4;

std::array<float, 3> in_floats(const Vec<3>& x) {
  return {static_cast<float>(x[0]), static_cast<float>(x[1]), static_cast<float>(x[2])};
}

// A block near a cell, and its distance from the cell's centre.
struct Near {
  uint32_t block;
  double distance;
};

class Builder {
 public:
  Builder(const FacetLevels& facets, int dimension) : facets_(facets), dimension_(dimension) {}

  GridTables build() {
    for (const FacetLevel& level : facets_.levels) make_blocks(level);
    Vec<3> low = facets_.triangles[0].corners[0], high = low;
    for (const FacetTriangle& triangle : facets_.triangles)
      for (const Vec<3>& corner : triangle.corners) {
        low = low.cwiseMin(corner);
        high = high.cwiseMax(corner);
      }
    low.array() -= kInnerPadding;
    high.array() += kInnerPadding;
    const size_t blocks = level_blocks_.front().size();
    uint32_t cells = blocks <= 4 ? 32 : blocks <= 128 ? 64 : 128;
    if (dimension_ == 2) cells *= 2;
    grid_.inner = lattice(low, high, cells);
    grid_.outer = lattice(Vec<3>::Constant(-kOuterReach), Vec<3>::Constant(kOuterReach), kOuterCells);
    fill(grid_.inner);
    fill(grid_.outer);
    grid_.lists.shrink_to_fit();
    grid_.slack.shrink_to_fit();
    grid_.far.shrink_to_fit();
    return std::move(grid_);
  }

 private:
  struct Cube {
    uint32_t x, y, z, size;  // in cells
  };

  void make_blocks(const FacetLevel& level) {
    std::vector<uint32_t> triangles(level.triangle_count);
    for (uint32_t i = 0; i < level.triangle_count; ++i) triangles[i] = level.first_triangle + i;
    const auto first = static_cast<uint32_t>(grid_.blocks.size());
    cut(triangles.data(), triangles.data() + triangles.size());
    level_blocks_.emplace_back();
    for (uint32_t block = first; block < grid_.blocks.size(); ++block) level_blocks_.back().push_back(block);
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

  // Lanes that are left over repeat the first triangle.
  void add_block(std::span<const uint32_t> triangles) {
    TriangleBlock block;
    double deviation = 0.0;
    for (size_t lane = 0; lane < kBlockLanes; ++lane) {
      const uint32_t triangle = triangles[lane < triangles.size() ? lane : 0];
      set_lane(block, lane, facets_.triangles[triangle].corners, triangle);
      deviation = std::max(deviation, facets_.deviation[facets_.triangles[triangle].facet]);
    }
    grid_.blocks.push_back(block);
    deviation_.push_back(deviation);
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
    evaluations_left_ = kEvaluationsMax;
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
        if (near.size() <= kBlocksEnough) return set(cube, listed(near));
        if (least_distance(near) > (near.size() > kBlocksMany ? kFarOfMany : kFar) * half)
          return set(cube, far(centre, near));
      }
      if (!finest && deviation_min(near) > kDetail * (near.front().distance + half)) continue;  // for all of the cube
      for (const Near& n : near) kept[level].push_back(n.block);
      next += near.size();
    }
    const uint32_t children = dimension_ == 2 ? 4 : 8;
    if (cube.size == 1 || evaluations_left_ < children * next) return set(cube, listed(near));
    const auto shared = std::make_shared<const Kept>(std::move(kept));
    const uint32_t step = cube.size / 2;
    for (uint32_t child = 0; child < children; ++child) {
      const Cube part{cube.x + step * (child & 1), cube.y + step * (child >> 1 & 1), cube.z + step * (child >> 2),
                      step};
      if (part.x < lattice_->count[0] && part.y < lattice_->count[1] && part.z < lattice_->count[2])
        tasks_.push_back({part, shared});
    }
  }

  // The blocks with the triangle nearest to some point within `half` of the centre, from near to far.
  std::vector<Near> nearest(const std::vector<uint32_t>& blocks, const Vec<3>& centre, double half) const {
    const std::array<float, 3> point = in_floats(centre);
    std::vector<Near> result;
    result.reserve(blocks.size());
    double least = std::numeric_limits<double>::infinity();
    for (const uint32_t block : blocks) {
      TriangleBlock::Lanes squared;
      block_distances_squared(grid_.blocks[block], point, squared);
      const double distance = std::sqrt(static_cast<double>(*std::min_element(squared.begin(), squared.end())));
      result.push_back({block, distance});
      least = std::min(least, distance + deviation_[block]);
    }
    const double bound = (least + 2 * half) * (1 + 2 * double{kBlockRelativeRounding}) + 4 * double{kBlockRounding};
    std::erase_if(result, [&](const Near& n) { return n.distance - deviation_[n.block] > bound; });
    std::sort(result.begin(), result.end(), [](const Near& a, const Near& b) {
      return a.distance < b.distance || (a.distance == b.distance && a.block < b.block);
    });
    return result;
  }

  double deviation_of(const std::vector<Near>& near) const {
    double deviation = 0.0;
    for (const Near& n : near) deviation = std::max(deviation, deviation_[n.block]);
    return deviation;
  }

  double deviation_min(const std::vector<Near>& near) const {
    double deviation = std::numeric_limits<double>::infinity();
    for (const Near& n : near) deviation = std::min(deviation, deviation_[n.block]);
    return deviation;
  }

  // Whether these blocks follow the cage as closely as the distance asks for.
  bool detailed(const std::vector<Near>& near, double half) const {
    return deviation_of(near) <= kDetail * std::max(0.0, near.front().distance - half);
  }

  double least_distance(const std::vector<Near>& near) const {
    double least = std::numeric_limits<double>::infinity();
    for (const Near& n : near) least = std::min(least, n.distance - deviation_[n.block]);
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

  // A list of these blocks; cells with the same ones share it, whatever their order. kNoCell where they are too many.
  uint32_t listed(const std::vector<Near>& near) {
    if (near.size() > kGridLengthMax || grid_.lists.size() > kListedMax) return kNoCell;
    std::vector<uint32_t> blocks;
    for (const Near& n : near) blocks.push_back(n.block);
    std::vector<uint32_t> key = blocks;
    std::sort(key.begin(), key.end());
    const auto [at, is_new] = lists_.try_emplace(std::move(key), static_cast<uint32_t>(grid_.lists.size()));
    if (is_new) {
      if (blocks.size() % 2 == 1) blocks.push_back(blocks.back());
      grid_.lists.insert(grid_.lists.end(), blocks.begin(), blocks.end());
      grid_.slack.resize(grid_.lists.size());
      grid_.slack[at->second] = static_cast<float>(deviation_of(near)) + kBlockRounding;
    }
    return at->second << kGridLengthBits | static_cast<uint32_t>(near.size());
  }

  const FacetLevels& facets_;
  const int dimension_;
  std::vector<double> deviation_;  // by block
  std::vector<std::vector<uint32_t>> level_blocks_;
  std::map<std::vector<uint32_t>, uint32_t> lists_;  // blocks, ascending, to where the list begins
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
