// The laws that walks are made of, by their moments over many counters.

#include <gtest/gtest.h>

#include "base/random.h"
#include "sample/directions.h"

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

template <int D>
void expect_uniform_directions() {
  const QueryRandom random(1, 2);
  Vec<D> mean = Vec<D>::Zero();
  Mat<D> second = Mat<D>::Zero();
  for (uint32_t i = 0; i < kDraws; ++i) {
    const Vec<D> direction = uniform_direction<D>(random.pair(i, 0));
    ASSERT_NEAR(direction.norm(), 1.0, 1e-14);
    mean += direction / kDraws;
    second += direction * direction.transpose() / kDraws;
  }
  EXPECT_LT(mean.norm(), 2 * kFive);
  EXPECT_LT((second - Mat<D>::Identity() / D).norm(), 3 * kFive);
}
TEST(Directions, AreUniform) {
  expect_uniform_directions<2>();
  expect_uniform_directions<3>();
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
