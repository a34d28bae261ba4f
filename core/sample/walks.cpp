#include "sample/walks.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "base/tolerances.h"
#include "sample/directions.h"
#include "sample/walk_lanes.h"

namespace barycast {
namespace {

// Walks under way at a time, at least, while there are queries left: enough that vectors stay full when single walks go
// on and on, and little enough for the nearest cache.
constexpr size_t kPoolWalks = 320;
// Walks between two looks at `cancel`: microseconds, but a hundred times that where thousands of triangles meet. A
// multiple of kWalkLanes.
constexpr size_t kCheckEvery = 128;
// Without re-entry a walk this far out comes back with a probability of 1e-6: it is discarded.
constexpr double kEscapeRadius = 1e6;

// Walks may arrive this part of the thickness early or late, and end that far from their closest point: where a walk
// ends within the thickness is as good as chance.
constexpr double kArrivalTolerance = 0.5;

// A number in [0, 1).
double unit(uint32_t bits) {
  return bits * 0x1p-32;
}

}  // namespace

// The walks under way: those of a query in a row, in the order of walks.
template <int D>
struct HarmonicWalks<D>::Pool {
  struct Group {
    size_t query;
    size_t begin, count;           // of its walks in the arrays
    size_t left;                   // of them under way
    uint32_t step;                 // that they are about to take
    std::array<uint32_t, 4> bits;  // random ones, for two steps
  };
  std::span<const SampleQuery<D>> queries;
  std::span<SampleSet<D>> out;
  std::vector<Group> groups;
  size_t count = 0;
  std::vector<float> x, y, z, radius;
  std::vector<uint32_t> walk, hint, key, rank, first, second, marked, kept;
  std::vector<int16_t> coarse_key;
  std::vector<LatticeWalks> lattices;  // by group
  std::array<CagePoint<D>, kCheckEvery> ends;

  WalkArrays arrays() { return {x.data(), y.data(), z.data(), radius.data(), walk.data(), hint.data()}; }

  // Room for `walks`. Vectors read beyond the end, and write there.
  Pool(std::span<const SampleQuery<D>> of, std::span<SampleSet<D>> into, size_t walks) : queries(of), out(into) {
    const size_t size = walks + 2 * kWalkLanes;
    for (auto* array : {&x, &y, &z, &radius}) array->resize(size);
    for (auto* array : {&walk, &hint, &key, &rank, &first, &second, &marked, &kept}) array->resize(size);
    coarse_key.resize(size);
  }

  // All walks of a query, at its origin.
  void add(size_t query, uint32_t walks) {
    groups.push_back({query, count, walks, walks, 0, {}});
    const Vec<D>& origin = queries[query].origin;
    for (uint32_t i = 0; i < walks; ++i, ++count) {
      set_position(count, origin);
      radius[count] = rounded_down(queries[query].radius);
      walk[count] = i;
      hint[count] = kNoHint;
    }
    out[query].clear();
    out[query].counts.started = walks;
    out[query].samples.resize(walks);
    for (Sample<D>& sample : out[query].samples) sample.weight = 1.0;
  }

  WalkPositions positions() const { return {x.data(), y.data(), z.data(), count}; }
  Vec<D> position(size_t i) const { return position_of<D>(positions(), i); }
  void set_position(size_t i, const Vec<D>& p) {
    x[i] = static_cast<float>(p[0]);
    y[i] = static_cast<float>(p[1]);
    z[i] = 0.0f;
    if constexpr (D == 3) z[i] = static_cast<float>(p[2]);
  }
  Sample<D>& sample_of(const Group& group, size_t i) { return out[group.query].samples[walk[i]]; }
  void end(Group& group, size_t i, const CagePoint<D>& at, SampleEnd how) {
    Sample<D>& sample = sample_of(group, i);
    sample = {at.point, sample.weight, at.shares, at.element, how};
    drop(group, i);
  }
  void discard(Group& group, size_t i) {
    ++out[group.query].counts.discarded;
    sample_of(group, i).weight = 0.0;
    drop(group, i);
  }

  // Closes the gaps of walks that ended, and the groups that have none left.
  void compact() {
    count = keep_walks(arrays(), kept.data(), count);
    size_t begin = 0;
    for (Group& group : groups) {
      group.begin = begin;
      begin += group.count = group.left;
    }
    std::erase_if(groups, [&](const Group& group) {
      if (group.count > 0) return false;
      SampleSet<D>& set = out[group.query];
      if (set.counts.discarded > 0)
        std::erase_if(set.samples, [](const Sample<D>& sample) { return sample.weight == 0.0; });
      return true;
    });
  }

 private:
  void drop(Group& group, size_t i) {
    kept[i] = 0;
    --group.left;
  }
};

// The groups of walks, which are asked for in order.
template <int D>
class HarmonicWalks<D>::GroupFinder {
 public:
  explicit GroupFinder(Pool& pool) : group_(pool.groups.data()) {}
  typename Pool::Group& of(size_t walk) {
    while (walk >= group_->begin + group_->count) ++group_;
    return *group_;
  }

 private:
  typename Pool::Group* group_;
};

// Numbers for the next step of every walk.
template <int D>
void HarmonicWalks<D>::draw_numbers(Pool& pool) const {
  if (settings_.as_printed) {
    for (const typename Pool::Group& group : pool.groups)
      independent_numbers(pool.queries[group.query].random, &pool.walk[group.begin], group.count, group.step,
                          &pool.first[group.begin], &pool.second[group.begin]);
    return;
  }
  pool.lattices.clear();
  for (typename Pool::Group& group : pool.groups) {
    const uint32_t part = group.step % 2;
    if (part == 0) group.bits = pool.queries[group.query].random.bits(0, group.step / 2);
    const auto order = group.step == 0 ? LatticeWalks::kInOrder : LatticeWalks::kAlongCurve;
    pool.lattices.push_back({group.begin, group.count, {group.bits[2 * part], group.bits[2 * part + 1]}, order});
  }
  lattice_numbers(pool.arrays(), pool.lattices, D - 1, {pool.key.data(), pool.rank.data(), pool.coarse_key.data()},
                  pool.first.data(), pool.second.data());
}

template <int D>
bool HarmonicWalks<D>::move(Pool& pool, const std::atomic<bool>& cancel) const {
  const float reach =
      settings_.as_printed ? std::numeric_limits<float>::infinity() : static_cast<float>(kReentryRadius);
  const size_t beyond =
      move_walks(pool.arrays(), pool.first.data(), pool.second.data(), pool.count, D, reach, pool.marked.data());
  GroupFinder groups(pool);
  for (size_t k = 0; k < beyond; ++k) {
    const uint32_t i = pool.marked[k];
    typename Pool::Group& group = groups.of(i);
    // The first step starts from the query itself, however far out it is.
    const Vec<D> from = group.step == 0 ? pool.queries[group.query].origin : pool.position(i);
    const double distance = from.norm();
    pool.set_position(i, exterior_hit(from, kEnclosingRadius, {unit(pool.first[i]), unit(pool.second[i])}));
    // In the plane Brownian motion comes back with certainty, in space with this probability.
    if constexpr (D == 3) pool.sample_of(group, i).weight *= kEnclosingRadius / distance;
    pool.hint[i] = kNoHint;
    ++pool.out[group.query].counts.reentries;
  }
  for (typename Pool::Group& group : pool.groups) {
    ++group.step;
    pool.out[group.query].counts.steps += group.count;
  }
  for (size_t i = 0; i < pool.count; i += kCheckEvery) {
    if (cancel.load(std::memory_order_relaxed)) return false;
    const size_t end = std::min(pool.count, i + kCheckEvery);
    if (settings_.as_printed) {
      // Radii that fall short would have more walks discarded at the limit: of FireHydrant's outside 36 in 100 for 31.
      for (size_t k = i; k < end; ++k) pool.radius[k] = rounded_down(distance_.free_radius(pool.position(k)));
      continue;
    }
    distance_.free_radii({&pool.x[i], &pool.y[i], &pool.z[i], end - i}, &pool.hint[i], &pool.radius[i]);
  }
  return true;
}

// Whether all of these walks are under way still. A free radius never exceeds the distance: only below the thickness
// may it have arrived.
template <int D>
bool HarmonicWalks<D>::settle_some(Pool& pool, std::span<const uint32_t> walks, GroupFinder& groups) const {
  const double tolerance = kArrivalTolerance * settings_.thickness;
  const std::span ends = std::span(pool.ends).first(walks.size());
  distance_.near(pool.positions(), walks, tolerance, ends);
  bool all_kept = true;
  for (size_t k = 0; k < walks.size(); ++k) {
    if (ends[k].distance < settings_.thickness) {
      pool.end(groups.of(walks[k]), walks[k], ends[k], SampleEnd::kArrived);
      all_kept = false;
    } else {
      pool.radius[walks[k]] = rounded_down(ends[k].distance - tolerance);
    }
  }
  return all_kept;
}

// Ends the walks that arrived or reached the step limit.
template <int D>
bool HarmonicWalks<D>::settle(Pool& pool, const std::atomic<bool>& cancel) const {
  std::fill_n(pool.kept.begin(), pool.count, 1u);
  const size_t near =
      find_arriving(pool.radius.data(), pool.count, static_cast<float>(settings_.thickness), pool.marked.data());
  bool all_kept = true;
  GroupFinder groups(pool);
  for (size_t k = 0; k < near; k += kCheckEvery) {
    if (cancel.load(std::memory_order_relaxed)) return false;
    all_kept &= settle_some(pool, std::span(pool.marked).subspan(k, std::min(kCheckEvery, near - k)), groups);
  }
  for (typename Pool::Group& group : pool.groups) {
    const bool at_limit = group.step >= settings_.walk_steps_max;
    if (!at_limit && !settings_.as_printed) continue;
    for (size_t i = group.begin; i < group.begin + group.count; ++i) {
      if (pool.kept[i] == 0) continue;
      if (at_limit && !settings_.as_printed) {
        if (i % kCheckEvery == 0 && cancel.load(std::memory_order_relaxed)) return false;
        ++pool.out[group.query].counts.capped;
        pool.end(group, i, distance_.closest(pool.position(i)), SampleEnd::kCapped);
      } else if (at_limit || pool.position(i).squaredNorm() > kEscapeRadius * kEscapeRadius) {
        pool.discard(group, i);
      }
      all_kept &= pool.kept[i] != 0;
    }
  }
  if (!all_kept) pool.compact();
  return true;
}

template <int D>
bool HarmonicWalks<D>::sample(std::span<const SampleQuery<D>> queries, const std::atomic<bool>& cancel,
                              std::span<SampleSet<D>> out) const {
  uint32_t most = 0;
  for (const SampleQuery<D>& query : queries) most = std::max(most, walks_of(query));
  Pool pool(queries, out, kPoolWalks + most);
  for (size_t next = 0; next < queries.size() || pool.count > 0;) {
    if (cancel.load(std::memory_order_relaxed)) return false;
    for (; next < queries.size() && pool.count < kPoolWalks; ++next) pool.add(next, walks_of(queries[next]));
    draw_numbers(pool);
    if (!move(pool, cancel) || !settle(pool, cancel)) return false;
  }
  return true;
}

void first_directions(const QueryRandom& random, std::span<Vec<3>> directions) {
  // Vectors read beyond the end, and write there.
  constexpr size_t kSome = kWalkLanes;
  std::array<float, 3 * kSome> x, y, z, radius;
  std::array<uint32_t, 3 * kSome> unused, first, second;
  std::array<int16_t, 3 * kSome> coarse;
  radius.fill(1.0f);
  const std::array<uint32_t, 4> bits = random.bits(0, 0);
  for (size_t begin = 0; begin < directions.size(); begin += kSome) {
    for (auto* coordinate : {&x, &y, &z}) coordinate->fill(0.0f);
    const WalkArrays walks{x.data(), y.data(), z.data(), radius.data(), unused.data(), unused.data()};
    const LatticeWalks some{0, kSome, {bits[0], bits[1]}, LatticeWalks::kInOrder, static_cast<uint32_t>(begin)};
    lattice_numbers(walks, {&some, 1}, 2, {unused.data(), unused.data(), coarse.data()}, first.data(), second.data());
    move_walks(walks, first.data(), second.data(), kSome, 3, static_cast<float>(kReentryRadius), unused.data());
    for (size_t i = begin; i < std::min(directions.size(), begin + kSome); ++i)
      directions[i] = Vec<3>(x[i - begin], y[i - begin], z[i - begin]).normalized();
  }
}

template class HarmonicWalks<2>;
template class HarmonicWalks<3>;

}  // namespace barycast
