#pragma once

// Counter-based random numbers: Philox4x32-10 [Salmon et al. 2011]. A number is a function of (seed,
// query position, walk, step) and of nothing else, so that a row does not depend on order, block, shard
// or thread. No state, no cost to seek; about 20 ns for 128 bits.

#include <array>
#include <bit>
#include <cstdint>

#include "base/vector.h"

namespace barycast {

// Philox4x32-10: ten rounds of a keyed bijection of 128-bit counters.
inline std::array<uint32_t, 4> philox(std::array<uint32_t, 4> counter, uint64_t key) {
  uint32_t key0 = static_cast<uint32_t>(key), key1 = static_cast<uint32_t>(key >> 32);
  for (int round = 0; round < 10; ++round) {
    const uint64_t product0 = uint64_t{0xD2511F53u} * counter[0];
    const uint64_t product1 = uint64_t{0xCD9E8D57u} * counter[2];
    counter = {static_cast<uint32_t>(product1 >> 32) ^ counter[1] ^ key0, static_cast<uint32_t>(product1),
               static_cast<uint32_t>(product0 >> 32) ^ counter[3] ^ key1, static_cast<uint32_t>(product0)};
    key0 += 0x9E3779B9u;
    key1 += 0xBB67AE85u;
  }
  return counter;
}

// A 64-bit name of a position in the normalized frame. Positions that compare equal have one name (-0
// counts as +0).
template <int D>
uint64_t position_key(const Vec<D>& position) {
  uint64_t key = 0;
  for (int i = 0; i < D; ++i) {
    const uint64_t bits = std::bit_cast<uint64_t>(position[i] + 0.0);
    const auto mixed = philox({static_cast<uint32_t>(bits), static_cast<uint32_t>(bits >> 32),
                               static_cast<uint32_t>(key), static_cast<uint32_t>(key >> 32)},
                              static_cast<uint64_t>(i));
    key = mixed[0] | (uint64_t{mixed[1]} << 32);
  }
  return key;
}

// The seed of an independent randomization, for every r another one; for 0 the same.
constexpr uint64_t randomized(uint64_t seed, uint64_t r) {
  return seed + r * 0x9E3779B97F4A7C15u;  // odd: distinct for all r
}

// The random numbers of one query point.
class QueryRandom {
 public:
  QueryRandom(uint64_t seed, uint64_t key) : seed_(seed), key_(key) {}

  uint64_t seed() const { return seed_; }
  uint64_t key() const { return key_; }

  // 128 random bits.
  std::array<uint32_t, 4> bits(uint32_t walk, uint32_t step) const {
    return philox({static_cast<uint32_t>(key_), static_cast<uint32_t>(key_ >> 32), walk, step}, seed_);
  }
  // Two uniform numbers in [0, 1) with 53 random bits each.
  std::array<double, 2> pair(uint32_t walk, uint32_t step) const {
    const auto b = bits(walk, step);
    return {unit(b[0], b[1]), unit(b[2], b[3])};
  }

 private:
  static double unit(uint32_t low, uint32_t high) {
    return static_cast<double>(((uint64_t{high} << 32) | low) >> 11) * 0x1p-53;
  }
  uint64_t seed_, key_;
};

}  // namespace barycast
