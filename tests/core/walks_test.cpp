// The laws that walks are made of, by their moments over many counters.

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <algorithm>
#include <numeric>
#include <random>

#include "base/random.h"
#include "query/distance_index.h"
#include "sample/directions.h"
#include "sample/walk_lanes.h"

namespace barycast {
namespace {

constexpr uint32_t kDraws = 200000;
// Five standard errors of a mean of values of variance one at most.
const double kFive = 5 / std::sqrt(double(kDraws));

TEST(Random, PhiloxMatchesThePublishedVectors) {
  // Known answers of the Random123 distribution, philox 4x32 10.
  EXPECT_EQ(philox({0, 0, 0, 0}, 0), (std::array<uint32_t, 4>{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  const uint32_t ones = 0xffffffff;
  EXPECT_EQ(philox({ones, ones, ones, ones}, 0xffffffffffffffff),
            (std::array<uint32_t, 4>{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, 0x299f31d0a4093822),
            (std::array<uint32_t, 4>{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

TEST(Random, PositionsThatCompareEqualHaveOneKey) {
  EXPECT_EQ(position_key<3>({0.0, 1, 2}), position_key<3>({-0.0, 1, 2}));
  EXPECT_NE(position_key<3>({0.0, 1, 2}), position_key<3>({0.0, 2, 1}));
}

TEST(Directions, SineAndCosineAreExactToRounding) {
  for (int i = 0; i <= 1000; ++i) {
    const double turns = i / 1000.0;
    const SineCosine own = sine_cosine_of_turns(turns);
    EXPECT_NEAR(own.sine, std::sin(2 * std::numbers::pi * turns), 2e-15);
    EXPECT_NEAR(own.cosine, std::cos(2 * std::numbers::pi * turns), 2e-15);
  }
}

// Where walks from the origin are after a step of length one, with independent numbers.
template <int D>
void expect_uniform_directions() {
  const size_t size = kDraws + kWalkLanes;
  std::vector<float> x(size), y(size), z(size), radius(size, 1.0f);
  std::vector<uint32_t> walk(size), hint(size), first(size), second(size), beyond(size);
  std::iota(walk.begin(), walk.end(), 0u);
  independent_numbers(QueryRandom(1, 2), walk.data(), kDraws, 0, first.data(), second.data());
  const WalkArrays walks{x.data(), y.data(), z.data(), radius.data(), walk.data(), hint.data()};
  ASSERT_EQ(move_walks(walks, first.data(), second.data(), kDraws, D, 0.5f, beyond.data()), 0u);
  Vec<D> mean = Vec<D>::Zero();
  Mat<D> moment = Mat<D>::Zero();
  for (uint32_t i = 0; i < kDraws; ++i) {
    Vec<D> direction;
    direction[0] = x[i];
    direction[1] = y[i];
    if constexpr (D == 3) direction[2] = z[i];
    ASSERT_NEAR(direction.norm(), 1.0, 5e-7);
    mean += direction / kDraws;
    moment += direction * direction.transpose() / kDraws;
  }
  EXPECT_LT(mean.norm(), 2 * kFive);
  EXPECT_LT((moment - Mat<D>::Identity() / D).norm(), 3 * kFive);
  // Now they are all beyond the reach, and stay.
  EXPECT_EQ(move_walks(walks, first.data(), second.data(), kDraws, D, 0.5f, beyond.data()), kDraws);
  EXPECT_EQ(beyond[kDraws - 1], kDraws - 1);
}
TEST(Directions, AreUniform) {
  expect_uniform_directions<2>();
  expect_uniform_directions<3>();
}

// Numbers of walks are those of their ranks along the curve, equal ones in order, whatever other queries walk along;
// beyond the cube of the curve, too, where keys are the largest that there are.
void expect_ranks_of_sorting(std::span<const size_t> counts, double spread) {
  size_t total = 0;
  std::vector<LatticeWalks> queries;
  for (const size_t count : counts) {
    const auto seed = static_cast<uint32_t>(queries.size());
    queries.push_back({total, count, {seed * 77u + 5u, seed * 1234567u}, LatticeWalks::kAlongCurve});
    if (queries.size() % 5 == 4) queries.back() = {total, count, {1u, 2u}, LatticeWalks::kInOrder, 9};
    total += count;
  }
  const size_t size = total + 2 * kWalkLanes;
  std::vector<float> x(size), y(size), z(size), radius(size);
  std::mt19937 random(static_cast<uint32_t>(total));
  std::uniform_real_distribution<double> uniform(-spread, spread);
  for (size_t i = 0; i < total; ++i)
    for (auto* const axis : {&x, &y, &z}) (*axis)[i] = static_cast<float>(uniform(random));
  std::vector<uint32_t> walk(size), hint(size), fine(size), rank(size), first(size), second(size);
  std::vector<int16_t> coarse(size);
  lattice_numbers({x.data(), y.data(), z.data(), radius.data(), walk.data(), hint.data()}, queries, 2,
                  {fine.data(), rank.data(), coarse.data()}, first.data(), second.data());
  for (const LatticeWalks& some : queries) {
    std::vector<uint32_t> order(some.count);
    std::iota(order.begin(), order.end(), 0u);
    const auto key = [&](uint32_t i) {
      return some.count <= kWalksCountedMax ? fine[some.begin + i] >> 15 : fine[some.begin + i];
    };
    if (some.order == LatticeWalks::kAlongCurve)
      std::stable_sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return key(a) < key(b); });
    // The lattice starts at its shift, and one step apart are the numbers of walks in order.
    const uint32_t step0 = 0xC13FA9A9u, step1 = 0x91E10DA5u;
    for (uint32_t r = 0; r < some.count; ++r) {
      const size_t i = some.begin + order[r];
      ASSERT_EQ(first[i], (some.first_rank + r) * step0 + some.shift[0]) << "rank " << r << " of " << some.count;
      ASSERT_EQ(second[i], (some.first_rank + r) * step1 + some.shift[1]) << "rank " << r << " of " << some.count;
    }
  }
}

TEST(Lattice, NumbersAreThoseOfRanks) {
  const std::vector<size_t> counts = {1, 16, 17, 600, 3, 255, 256, 257, 31, 33, 2, 50, 64, 300, 15};
  for (const int64_t targets : {int64_t{0}, int64_t{HWY_AVX2}}) {
    hwy::SetSupportedTargetsForTest(targets);
    for (const double spread : {1e-4, 0.05, 0.7, 1.4}) expect_ranks_of_sorting(counts, spread);
    expect_ranks_of_sorting(std::array<size_t, 1>{40}, 0.0);
    hwy::SetSupportedTargetsForTest(0);
  }
}

// All where the curve ends.
TEST(Lattice, NumbersDifferWhereKeysAreTheLargest) {
  for (const int64_t targets : {int64_t{0}, int64_t{HWY_AVX2}}) {
    hwy::SetSupportedTargetsForTest(targets);
    const size_t count = 40, size = count + 2 * kWalkLanes;
    std::vector<float> at(size, 0.74f), radius(size);
    std::vector<uint32_t> unused(size), fine(size), rank(size), first(size), second(size);
    std::vector<int16_t> coarse(size);
    const LatticeWalks walks{0, count, {0, 0}, LatticeWalks::kAlongCurve};
    lattice_numbers({at.data(), at.data(), at.data(), radius.data(), unused.data(), unused.data()}, {&walks, 1}, 2,
                    {fine.data(), rank.data(), coarse.data()}, first.data(), second.data());
    for (uint32_t i = 0; i < count; ++i) EXPECT_EQ(first[i], i * 0xC13FA9A9u);
    hwy::SetSupportedTargetsForTest(0);
  }
}

// The vector code draws the numbers that QueryRandom does.
TEST(Random, WalksDrawTheNumbersOfTheirQuery) {
  const QueryRandom random(0x123456789abcdef0, 0xfedcba9876543210);
  std::vector<uint32_t> walk(40), first(64), second(64);
  std::iota(walk.begin(), walk.end(), 5u);
  independent_numbers(random, walk.data(), 24, 7, first.data(), second.data());
  for (size_t i = 0; i < 24; ++i) {
    EXPECT_EQ(first[i], random.bits(walk[i], 7)[0]);
    EXPECT_EQ(second[i], random.bits(walk[i], 7)[2]);
  }
}

// Under the exterior hitting law harmonic functions that vanish at infinity keep their means: for the
// law conditioned on hitting, the mean of the first and second spherical harmonics is rho and rho^2.
template <int D>
void expect_exterior_law(double distance) {
  const QueryRandom random(3, static_cast<uint64_t>(distance * 1000));
  const Vec<D> axis = Vec<D>::Ones().normalized();
  const double radius = 0.52, rho = radius / distance;
  double first = 0.0, second = 0.0;
  Vec<D> mean = Vec<D>::Zero();
  for (uint32_t i = 0; i < kDraws; ++i) {
    const Vec<D> hit = exterior_hit<D>(distance * axis, radius, random.pair(i, 0)) / radius;
    ASSERT_NEAR(hit.norm(), 1.0, 1e-12);
    const double cosine = hit.dot(axis);
    mean += hit / kDraws;
    first += cosine / kDraws;
    second += (D == 2 ? 2 * cosine * cosine - 1 : 1.5 * cosine * cosine - 0.5) / kDraws;
  }
  EXPECT_NEAR(first, rho, kFive);
  EXPECT_NEAR(second, rho * rho, kFive);
  EXPECT_LT((mean - first * axis).norm(), 2 * kFive);  // symmetric around the axis
}
TEST(Directions, ExteriorHitsFollowThePoissonKernel) {
  for (const double distance : {0.53, 0.7, 1.0, 5.0, 1e4}) {
    expect_exterior_law<2>(distance);
    expect_exterior_law<3>(distance);
  }
}

}  // namespace
}  // namespace barycast
