#include "query/cube_search.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

namespace barycast {
namespace {

// Cubes with more triangles than a block holds are cut, or, where everything is this many of their half diagonals away,
// and larger than cells, only know how far it is: their radii are (k - 1) / (k + 1) of the distance at least. Less far
// is enough where triangles are many.
constexpr size_t kTrianglesMany = 6 * kBlockLanes;
constexpr double kFar = 8.0, kFarOfMany = 4.0;
// Where they are too many for lists; radii are half the distance at least. Nearer than this, Embree is asked.
constexpr double kFarLeast = 3.0;
// Facets may deviate by this part of the distance, which the radius then falls short by.
constexpr double kDetail = 0.025;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kRounding{kBlockRounding}, kRelativeRounding{kBlockRelativeRounding};

float rounded_up(double x) {
  return static_cast<float>(x * (1 + 1e-7));
}

// No triangle farther from the centre than this is nearest to a point within `half` of it, where one is as near as
// `distance`.
double bound_of(double distance, double half) {
  return (distance + 2 * half) * (1 + 2 * kRelativeRounding) + 4 * kRounding;
}

void add(TriangleSet& set, uint32_t triangle, double deviation) {
  set.first = set.count == 0 ? triangle : std::min(set.first, triangle);
  set.triangle[set.count++] = triangle;
  set.signature |= uint64_t{1} << (triangle % 64);
  set.slack = std::max(set.slack, static_cast<float>(deviation) + kBlockRounding);
}

}  // namespace

std::array<float, 3> in_floats(const Vec<3>& x) {
  return {static_cast<float>(x[0]), static_cast<float>(x[1]), static_cast<float>(x[2])};
}

void CubesFound::clear() {
  cubes.clear();
  near.clear();
  sets.clear();
}

void CubeSearch::search(const CubeQuery& cube, const KeptBlocks& kept, CubesFound& out) {
  const auto size = [&] { return static_cast<uint32_t>(out.near.size()); };
  CubeFound found;
  found.near_begin = size();
  const size_t levels = blocks_.level_end.size();
  uint32_t begin = 0;
  for (size_t level = 0; level < levels; ++level) {
    const uint32_t count = kept.level_end[level] - begin;
    const auto blocks = kept.blocks.subspan(begin, count);
    const auto distances = kept.distances.subspan(begin, count);
    begin += count;
    found.level_end[level] = size();
    if (count == 0) continue;
    found.evaluations += count;
    found.own_begin = size();
    const Extremes near = append_nearest(blocks, distances, cube, out.near);
    const double least_distance = near.least * (1 - kRelativeRounding) - kRounding;
    found.least_distance = static_cast<float>(least_distance);
    found.is_outside = least_distance > kFarLeast * cube.half;
    const bool finest = level + 1 == levels;
    // Whether these blocks follow the cage as closely as the distance asks for.
    if (finest || near.deviation_most <= kDetail * std::max(0.0, near.nearest - cube.half)) {
      const bool many = near.triangles > kTrianglesMany;
      if (near.triangles <= kBlockLanes) {
        found.kind = CubeFound::Kind::kListed;
      } else if ((!cube.is_cell || many) && least_distance > (many ? kFarOfMany : kFar) * cube.half) {
        found.kind = CubeFound::Kind::kFar;
      }
      if (found.kind != CubeFound::Kind::kOpen) break;
    }
    if (!finest && near.deviation_least > kDetail * (near.nearest + cube.half))
      out.near.resize(found.own_begin);  // too coarse for all of the cube
    found.level_end[level] = size();
  }
  found.near_end = size();
  const bool is_cut = found.kind == CubeFound::Kind::kOpen && !cube.is_cell && found.kept() <= cube.kept_max;
  if (found.kind != CubeFound::Kind::kFar && !is_cut) prepare_list(found, blocks_, out);
  out.cubes.push_back(found);
}

// Appends the blocks with a triangle nearest to some point in the cube; the nearest block first.
CubeSearch::Extremes CubeSearch::append_nearest(std::span<const uint32_t> blocks, std::span<const float> distances,
                                                const CubeQuery& cube, std::vector<Near>& near) {
  measure(blocks, distances, cube);
  const double bound = bound_of(least_sum(), cube.half);
  limits_.resize(measured_.size());
  size_t count = 0;
  for (uint32_t i = 0; i < measured_.size(); ++i) {  // without a branch: as many are near as not
    limits_[count] = {i, rounded_up(bound + deviation_[i])};
    count += double{distance_[i]} - deviation_[i] <= bound ? 1 : 0;
  }
  limits_.resize(count);
  lanes_.resize(count);
  lanes_within(squared_.data(), limits_, lanes_.data());

  Extremes result{kInfinity, kInfinity, kInfinity, 0.0, 0};
  const size_t begin = near.size();
  size_t nearest = begin;
  for (size_t i = 0; i < count; ++i) {
    const uint32_t measured = limits_[i].index, block = measured_[measured];
    const uint32_t lanes = lanes_[i] & ((1u << blocks_.count[block]) - 1);
    if (lanes == 0) continue;
    const double distance{distance_[measured]}, deviation = deviation_[measured];
    if (distance < result.nearest) nearest = near.size();
    result.nearest = std::min(result.nearest, distance);
    result.least = std::min(result.least, distance - deviation);
    result.deviation_least = std::min(result.deviation_least, deviation);
    result.deviation_most = std::max(result.deviation_most, deviation);
    result.triangles += static_cast<uint32_t>(std::popcount(lanes));
    near.push_back({block, distance_[measured], lanes});
  }
  if (nearest > begin) std::swap(near[begin], near[nearest]);
  return result;
}

// Measures the blocks that may be near. The first ones, among them the nearest to the parent's centre, tell which of
// the others are too far away, without measuring: none of them changes the result.
void CubeSearch::measure(std::span<const uint32_t> blocks, std::span<const float> distances, const CubeQuery& cube) {
  const std::array<float, 3> point = in_floats(cube.centre);
  const auto measure_from = [&](size_t begin) {
    squared_.resize(measured_.size());
    deviation_.resize(measured_.size());
    distance_.resize((measured_.size() + kBlockLanes - 1) / kBlockLanes * kBlockLanes);
    block_distances(blocks_.distances.data(), std::span(measured_).subspan(begin), point, squared_.data() + begin,
                    distance_.data() + begin);
    for (size_t i = begin; i < measured_.size(); ++i) deviation_[i] = blocks_.deviation[measured_[i]];
  };
  const size_t first = std::min(blocks.size(), kBlockLanes);
  measured_.assign(blocks.begin(), blocks.begin() + static_cast<std::ptrdiff_t>(first));
  measure_from(0);
  if (first == blocks.size()) return;
  // From the parent's centre to this one it is half its diagonal; what is measured may be wrong at both.
  const double reach = bound_of(least_sum(), cube.half) + cube.half + 4 * kRounding;
  size_t count = first;
  measured_.resize(blocks.size());
  for (size_t i = first; i < blocks.size(); ++i) {
    measured_[count] = blocks[i];
    count += double{distances[i]} * (1 - 4 * kRelativeRounding) - blocks_.deviation[blocks[i]] <= reach ? 1 : 0;
  }
  measured_.resize(count);
  measure_from(first);
}

// How far the nearest element is at most.
double CubeSearch::least_sum() const {
  std::array<double, 4> least;  // apart, since each waits for the one before
  least.fill(kInfinity);
  for (size_t i = 0; i < measured_.size(); ++i)
    least[i % 4] = std::min(least[i % 4], double{distance_[i]} + deviation_[i]);
  return *std::min_element(least.begin(), least.end());
}

void order(std::span<Near> near) {
  std::sort(near.begin(), near.end(), [](const Near& a, const Near& b) {
    return a.distance < b.distance || (a.distance == b.distance && a.block < b.block);
  });
}

void prepare_list(CubeFound& found, const NeighbourBlocks& blocks, CubesFound& out) {
  const std::span<Near> near = out.own(found);
  found.is_prepared = true;
  found.sets_begin = found.sets_end = static_cast<uint32_t>(out.sets.size());
  size_t triangles = 0;
  for (const Near& n : near) triangles += static_cast<size_t>(std::popcount(n.lanes));
  if (triangles > kBlockLanes) order(near);  // a single set is the same in any order
  if (triangles > kOwnBlocksOfCell * kBlockLanes) return;
  size_t added = 0;
  for (const Near& n : near)
    for (uint32_t lanes = n.lanes; lanes != 0; lanes &= lanes - 1) {
      if (added++ % kBlockLanes == 0) out.sets.push_back({});
      const uint32_t triangle = blocks.triangles(n.block)[static_cast<size_t>(std::countr_zero(lanes))];
      add(out.sets.back(), triangle, blocks.triangle_deviation[triangle]);
    }
  found.sets_end = static_cast<uint32_t>(out.sets.size());
}

}  // namespace barycast
