#include "query/grid_builder.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/parallel.h"
#include "base/tolerances.h"
#include "base/workspace.h"
#include "query/cube_search.h"
#include "query/grid_lists.h"

namespace barycast {
namespace {

// Around the cage's box, in diagonals: walks near the cage from outside find fine cells there.
constexpr double kInnerPadding = 0.02;
// Half the outer lattice's side: beyond kReentryRadius walks are brought back.
constexpr double kOuterReach = kReentryRadius + 0.01;
constexpr uint32_t kOuterCells = 32;
// Evaluations of blocks, of some ten nanoseconds each, for a lattice: so many for every triangle, within bounds. Cubes
// are cut from large to small: where a cage is too dense for it, all cells stay coarse, and list more.
constexpr uint64_t kEvaluationsLeast = 2'400'000, kEvaluationsMost = 15'000'000, kEvaluationsPerTriangle = 150;
// A position may be found in the cell beside its own by rounding: cells cover a little more than themselves.
constexpr double kCellMargin = 1.0 + 1e-4;
// Cubes that were cut, for one task, of some ten microseconds; and tasks before what they found is placed.
constexpr size_t kFamiliesPerTask = 8, kTasksAtATime = 64;

struct Cube {
  uint32_t x, y, z, size;  // in cells
};

// Cubes of one size that were cut, each into a family of cubes, and the blocks that their families inherit.
struct Wave {
  struct Family {
    Cube cube;
    uint32_t kept_begin;
    std::array<uint32_t, kFacetLevelsMax> level_end;  // from there
  };
  std::vector<Family> families;
  std::vector<uint32_t> blocks;
  std::vector<float> distances;

  KeptBlocks kept(const Family& family, size_t levels) const {
    const uint32_t count = family.level_end[levels - 1];
    return {std::span(blocks).subspan(family.kept_begin, count), std::span(distances).subspan(family.kept_begin, count),
            family.level_end};
  }
  void clear() {
    families.clear();
    blocks.clear();
    distances.clear();
  }
};

// Waves of cubes, from large to small. Cubes are searched on all threads, and what was found is placed in the tables in
// their order, by one thread, while the next ones are searched: tables do not depend on the threads.
class Builder {
 public:
  Builder(const FacetLevels& facets, int dimension)
      : facets_(facets),
        dimension_(dimension),
        neighbours_(make_neighbour_blocks(facets)),
        lists_(neighbours_, facets.levels.front().triangle_count, grid_),
        searches_([this] { return CubeSearch(neighbours_); }) {}

  GridTables build() {
    Vec<3> low = facets_.triangles[0].corners[0], high = low;
    for (const FacetTriangle& triangle : facets_.triangles)
      for (const Vec<3>& corner : triangle.corners) {
        low = low.cwiseMin(corner);
        high = high.cwiseMax(corner);
      }
    low.array() -= kInnerPadding;
    high.array() += kInnerPadding;
    const size_t triangles = facets_.levels.front().triangle_count;
    uint32_t cells = triangles <= 32 ? 32 : triangles <= 1024 ? 64 : 112;
    if (dimension_ == 2) cells *= 2;
    grid_.inner = lattice(low, high, cells);
    grid_.outer = lattice(Vec<3>::Constant(-kOuterReach), Vec<3>::Constant(kOuterReach), kOuterCells);
    fill(grid_.inner);
    fill(grid_.outer);
    lists_.make_blocks(facets_, dimension_);
    grid_.cells.push_back(kNoCell);
    grid_.cells.shrink_to_fit();
    grid_.lists.resize(grid_.lists.size() + kGridListsPadding);
    grid_.lists.shrink_to_fit();
    grid_.far.shrink_to_fit();
    return std::move(grid_);
  }

 private:
  // What the tasks of a part of a wave found.
  struct Part {
    size_t first_task = 0, tasks = 0;
    std::vector<CubesFound> found = std::vector<CubesFound>(kTasksAtATime);
  };

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

  void fill(const GridLattice& lattice) {
    lattice_ = &lattice;
    evaluations_left_ = std::clamp<uint64_t>(kEvaluationsPerTriangle * facets_.levels.front().triangle_count,
                                             kEvaluationsLeast, kEvaluationsMost);
    // The first family: one cube around the lattice, its siblings outside.
    const uint32_t size = std::bit_ceil(std::max({lattice.count[0], lattice.count[1], lattice.count[2]}));
    wave_.clear();
    wave_.families.push_back({{0, 0, 0, 2 * size}, 0, {}});
    std::copy(neighbours_.level_end.begin(), neighbours_.level_end.end(), wave_.families[0].level_end.begin());
    wave_.blocks.resize(neighbours_.distances.size());
    for (uint32_t block = 0; block < wave_.blocks.size(); ++block) wave_.blocks[block] = block;
    wave_.distances.resize(wave_.blocks.size());  // 0: from no centre yet
    while (!wave_.families.empty()) {
      next_.clear();
      fill_wave();
      std::swap(wave_, next_);
    }
  }

  void fill_wave() {
    const size_t tasks = (wave_.families.size() + kFamiliesPerTask - 1) / kFamiliesPerTask;
    Part* search = &parts_[0];
    Part* place = &parts_[1];
    place->tasks = 0;
    for (size_t first = 0; first < tasks || place->tasks > 0; first += kTasksAtATime) {
      *search = {first, first < tasks ? std::min(kTasksAtATime, tasks - first) : 0, std::move(search->found)};
      // As of now, so that searches do not read what place_part() writes. It only decreases: who may not be cut by it,
      // may not later.
      const uint64_t evaluations_left = evaluations_left_;
      parallel_build(1 + search->tasks, 1, [&](size_t begin, size_t end) {
        for (size_t i = begin; i < end; ++i)
          i == 0 ? place_part(*place) : search_task(search->first_task + i - 1, evaluations_left, search->found[i - 1]);
      });
      std::swap(search, place);
    }
  }

  std::span<const Wave::Family> families_of(size_t task) const {
    const size_t first = task * kFamiliesPerTask;
    return std::span(wave_.families).subspan(first, std::min(kFamiliesPerTask, wave_.families.size() - first));
  }

  // Calls visit(cube) for the cubes that one was cut into, but for those outside of the lattice.
  template <class Visit>
  void for_each_child(const Cube& cube, const Visit& visit) const {
    const uint32_t step = cube.size / 2;
    for (uint32_t child = 0; child < children(); ++child) {
      const Cube part{cube.x + step * (child & 1), cube.y + step * (child >> 1 & 1), cube.z + step * (child >> 2),
                      step};
      if (part.x < lattice_->count[0] && part.y < lattice_->count[1] && part.z < lattice_->count[2]) visit(part);
    }
  }
  uint32_t children() const { return dimension_ == 2 ? 4 : 8; }

  Vec<3> centre_of(const Cube& cube) const {
    const double half = 0.5 * cube.size;
    const auto at = [&](size_t k, uint32_t from) { return lattice_->low[k] + (from + half) * lattice_->cell; };
    return {at(0, cube.x), at(1, cube.y), dimension_ == 2 ? 0.0 : at(2, cube.z)};
  }

  void search_task(size_t task, uint64_t evaluations_left, CubesFound& out) {
    CubeSearch& search = searches_.local();
    out.clear();
    for (const Wave::Family& family : families_of(task)) {
      const KeptBlocks kept = wave_.kept(family, neighbours_.level_end.size());
      for_each_child(family.cube, [&](const Cube& cube) {
        const double half = 0.5 * cube.size * lattice_->cell * std::sqrt(dimension_) * kCellMargin;
        search.search({centre_of(cube), half, cube.size == 1, evaluations_left / children()}, kept, out);
      });
    }
  }

  void place_part(Part& part) {
    for (size_t task = 0; task < part.tasks; ++task) {
      CubesFound& found = part.found[task];
      size_t next = 0;
      for (const Wave::Family& family : families_of(part.first_task + task))
        for_each_child(family.cube, [&](const Cube& cube) { place(cube, found.cubes[next++], found); });
    }
  }

  void place(const Cube& cube, CubeFound& found, CubesFound& all) {
    using Kind = CubeFound::Kind;
    evaluations_left_ -= std::min<uint64_t>(evaluations_left_, found.evaluations);
    if (found.kind == Kind::kFar) return set(cube, far(cube, found));
    if (found.kind == Kind::kOpen) {
      if (cube.size > 1 && evaluations_left_ >= children() * found.kept()) return cut(cube, found, all);
      if (!found.is_prepared) prepare_list(found, neighbours_, all);
    }
    const auto sets = std::span(all.sets).subspan(found.sets_begin, found.sets_end - found.sets_begin);
    const uint32_t value = lists_.list(all.own(found), sets);
    // Where the triangles are too many for a list, how far they are will do, unless they are in the cell or next to it.
    const bool by_distance = value == kNoCell && found.kind == Kind::kOpen && found.is_outside;
    set(cube, by_distance ? far(cube, found) : value);
  }

  void cut(const Cube& cube, const CubeFound& found, const CubesFound& all) {
    Wave::Family family{cube, static_cast<uint32_t>(next_.blocks.size()), found.level_end};
    for (uint32_t& end : family.level_end) end -= std::min(end, found.near_begin);
    next_.families.push_back(family);
    for (const Near& near : std::span(all.near).subspan(found.near_begin, found.kept())) {
      next_.blocks.push_back(near.block);
      next_.distances.push_back(near.distance);
    }
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

  uint32_t far(const Cube& cube, const CubeFound& found) {
    grid_.far.push_back({in_floats(centre_of(cube)), found.least_distance});
    return kGridFarBit | static_cast<uint32_t>(grid_.far.size() - 1);
  }

  const FacetLevels& facets_;
  const int dimension_;
  GridTables grid_;
  const NeighbourBlocks neighbours_;
  GridLists lists_;
  PerThread<CubeSearch> searches_;
  const GridLattice* lattice_ = nullptr;
  uint64_t evaluations_left_ = 0;
  Wave wave_, next_;  // of the size at hand, and of half of it
  std::array<Part, 2> parts_;
};

}  // namespace

GridTables build_grid(const FacetLevels& facets, int dimension) {
  return Builder(facets, dimension).build();
}

}  // namespace barycast
