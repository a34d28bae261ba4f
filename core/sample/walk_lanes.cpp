#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sample/walk_lanes.cpp"  // this file, once for every processor
#include "sample/walk_lanes.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <array>
#include <numeric>
#include <vector>

#include "query/distance_index.h"

HWY_BEFORE_NAMESPACE();
namespace barycast::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using Tag = hn::CappedTag<float, kWalkLanes>;
using BitsTag = hn::RebindToUnsigned<Tag>;
using Floats = hn::Vec<Tag>;
using Bits = hn::Vec<BitsTag>;
constexpr Tag kTag;
constexpr BitsTag kBitsTag;
constexpr size_t kWidth = hn::MaxLanes(kTag);

constexpr size_t kKeyLanes = 2 * kWalkLanes;
using KeyTag = hn::CappedTag<int16_t, kKeyLanes>;
constexpr KeyTag kKeyTag;
constexpr size_t kKeyWidth = hn::MaxLanes(kKeyTag);

// Cells of the curve, along an axis, and what they cover: positions beyond go to the outermost. The same at every step:
// over the cube that holds the walks, which changes from step to step, the error of 5,000 walks was a tenth larger.
constexpr float kCurveCells = 1024.0f, kCurveReach = 0.75f;

// Keys of 30 bits, and their upper halves.
void curve_keys(const WalkArrays& walks, size_t count, uint32_t* fine, int16_t* coarse) {
  const hn::RebindToSigned<Tag> signed_tag;
  const hn::Rebind<int16_t, Tag> half_tag;
  // Ten bits, each followed by two zeros.
  const auto spread = [&](const float* coordinate) {
    const Floats cells = hn::MulAdd(hn::LoadU(kTag, coordinate), hn::Set(kTag, kCurveCells / (2 * kCurveReach)),
                                    hn::Set(kTag, kCurveCells / 2));
    const Floats inside = hn::Min(hn::Max(cells, hn::Zero(kTag)), hn::Set(kTag, kCurveCells - 1));
    Bits bits = hn::BitCast(kBitsTag, hn::ConvertTo(signed_tag, inside));
    const auto mask = [](uint32_t value) { return hn::Set(kBitsTag, value); };
    bits = hn::And(hn::Or(bits, hn::ShiftLeft<16>(bits)), mask(0x030000FFu));
    bits = hn::And(hn::Or(bits, hn::ShiftLeft<8>(bits)), mask(0x0300F00Fu));
    bits = hn::And(hn::Or(bits, hn::ShiftLeft<4>(bits)), mask(0x030C30C3u));
    return hn::And(hn::Or(bits, hn::ShiftLeft<2>(bits)), mask(0x09249249u));
  };
  for (size_t i = 0; i < count; i += kWidth) {
    const Bits bits = hn::Or(hn::ShiftLeft<2>(spread(walks.x + i)),
                             hn::Or(hn::ShiftLeft<1>(spread(walks.y + i)), spread(walks.z + i)));
    hn::StoreU(bits, kBitsTag, fine + i);
    hn::StoreU(hn::DemoteTo(half_tag, hn::BitCast(signed_tag, hn::ShiftRight<15>(bits))), half_tag, coarse + i);
  }
}

// In lane i of the vector at kKeyLanes - 1 - j, 1 where i is above j.
constexpr auto kLanesAbove = [] {
  std::array<int16_t, 2 * kKeyLanes> result{};
  std::fill(result.begin() + kKeyLanes, result.end(), int16_t{1});
  return result;
}();

// How many of `count` keys come before each of those from `begin` on: of equal ones those with lower indices.
HWY_INLINE hn::Vec<KeyTag> keys_before(const int16_t* key, size_t count, size_t begin) {
  const auto own = hn::LoadU(kKeyTag, key + begin);
  // A true comparison is -1.
  const auto less = [](auto a, auto b) { return hn::VecFromMask(kKeyTag, hn::Lt(a, b)); };
  const size_t end = std::min(begin + kKeyWidth, count);
  auto before = hn::Set(kKeyTag, static_cast<int16_t>(begin));
  for (size_t j = 0; j < begin; ++j) before = hn::Add(before, less(own, hn::Set(kKeyTag, key[j])));
  for (size_t j = begin; j < end; ++j) {
    // From the key and not to the own ones, of which the largest is the largest there is.
    const auto above = hn::LoadU(kKeyTag, kLanesAbove.data() + kKeyLanes - 1 - (j - begin));
    before = hn::Sub(before, less(hn::Sub(hn::Set(kKeyTag, key[j]), above), own));
  }
  for (size_t j = end; j < count; ++j) before = hn::Sub(before, less(hn::Set(kKeyTag, key[j]), own));
  return before;
}

HWY_INLINE void lattice_points(Bits rank, const std::array<uint32_t, 2>& steps, const std::array<uint32_t, 2>& shift,
                               uint32_t* first, uint32_t* second) {
  hn::StoreU(hn::Add(hn::Mul(rank, hn::Set(kBitsTag, steps[0])), hn::Set(kBitsTag, shift[0])), kBitsTag, first);
  hn::StoreU(hn::Add(hn::Mul(rank, hn::Set(kBitsTag, steps[1])), hn::Set(kBitsTag, shift[1])), kBitsTag, second);
}

// Of queries in their order: what is written beyond the end of one is written again by the next.
void counted_numbers(std::span<const LatticeWalks> queries, const int16_t* key, const std::array<uint32_t, 2>& steps,
                     uint32_t* first, uint32_t* second) {
  const hn::Rebind<int16_t, Tag> half_tag;
  const hn::RebindToSigned<Tag> signed_tag;
  HWY_ALIGN int16_t before[kKeyWidth];
  for (const LatticeWalks& walks : queries) {
    if (walks.order == LatticeWalks::kInOrder) {
      for (size_t i = 0; i < walks.count; i += kWidth)
        lattice_points(hn::Iota(kBitsTag, walks.first_rank + static_cast<uint32_t>(i)), steps, walks.shift,
                       first + walks.begin + i, second + walks.begin + i);
      continue;
    }
    if (walks.count > kWalksCountedMax) continue;
    for (size_t begin = 0; begin < walks.count; begin += kKeyWidth) {
      hn::Store(keys_before(key + walks.begin, walks.count, begin), kKeyTag, before);
      for (size_t i = 0; i < kKeyWidth && begin + i < walks.count; i += kWidth)
        lattice_points(hn::BitCast(kBitsTag, hn::PromoteTo(signed_tag, hn::LoadU(half_tag, before + i))), steps,
                       walks.shift, first + walks.begin + begin + i, second + walks.begin + begin + i);
    }
  }
}

// a b, high and low halves of the 64 bits.
struct Product {
  Bits high, low;
};
HWY_INLINE Product multiply(Bits a, uint32_t b) {
  const Bits factor = hn::Set(kBitsTag, b);
  const hn::RepartitionToWide<BitsTag> wide;
  const auto odd_to_even = [&](Bits v) { return hn::BitCast(kBitsTag, hn::ShiftRight<32>(hn::BitCast(wide, v))); };
  const Bits even = hn::BitCast(kBitsTag, hn::MulEven(a, factor));
  const Bits odd = hn::BitCast(kBitsTag, hn::MulEven(odd_to_even(a), factor));
  const Bits high = hn::OddEven(odd, odd_to_even(even));
  return {high, hn::Mul(a, factor)};
}

// philox of base/random.h, a walk in every lane.
void independent(const QueryRandom& random, const uint32_t* walk, size_t count, uint32_t step, uint32_t* first,
                 uint32_t* second) {
  const auto key_low = static_cast<uint32_t>(random.key()), key_high = static_cast<uint32_t>(random.key() >> 32);
  for (size_t i = 0; i < count; i += kWidth) {
    Bits c0 = hn::Set(kBitsTag, key_low), c1 = hn::Set(kBitsTag, key_high), c2 = hn::LoadU(kBitsTag, walk + i),
         c3 = hn::Set(kBitsTag, step);
    auto key0 = static_cast<uint32_t>(random.seed()), key1 = static_cast<uint32_t>(random.seed() >> 32);
    for (int round = 0; round < 10; ++round) {
      const Product p0 = multiply(c0, 0xD2511F53u), p1 = multiply(c2, 0xCD9E8D57u);
      c0 = hn::Xor(p1.high, hn::Xor(c1, hn::Set(kBitsTag, key0)));
      c2 = hn::Xor(p0.high, hn::Xor(c3, hn::Set(kBitsTag, key1)));
      c1 = p1.low;
      c3 = p0.low;
      key0 += 0x9E3779B9u;
      key1 += 0xBB67AE85u;
    }
    hn::StoreU(c0, kBitsTag, first + i);
    hn::StoreU(c2, kBitsTag, second + i);
  }
}

// Sine and cosine of 2 pi bits / 2^32, to 2e-7: from the nearest quarter turn, by polynomials.
HWY_INLINE void sine_cosine(Bits bits, Floats& sine, Floats& cosine) {
  const hn::RebindToSigned<Tag> signed_tag;
  const Bits quarter = hn::ShiftRight<30>(hn::Add(bits, hn::Set(kBitsTag, 1u << 29)));
  const auto rest = hn::BitCast(signed_tag, hn::Sub(bits, hn::ShiftLeft<30>(quarter)));
  const Floats x = hn::Mul(hn::ConvertTo(kTag, rest), hn::Set(kTag, 6.283185307f * 0x1p-32f));
  const Floats x2 = hn::Mul(x, x);
  const auto set = [](float value) { return hn::Set(kTag, value); };
  const Floats s = hn::MulAdd(hn::MulAdd(set(-1.9515296e-4f), x2, set(8.3321609e-3f)), x2, set(-1.6666655e-1f));
  const Floats near_sine = hn::MulAdd(hn::Mul(s, x2), x, x);
  const Floats c = hn::MulAdd(hn::MulAdd(set(2.4433157e-5f), x2, set(-1.3887316e-3f)), x2, set(4.1666646e-2f));
  const Floats near_cosine = hn::MulAdd(hn::MulAdd(c, x2, set(-0.5f)), x2, set(1.0f));
  const auto odd = hn::RebindMask(kTag, hn::Ne(hn::And(quarter, hn::Set(kBitsTag, 1u)), hn::Zero(kBitsTag)));
  const auto flip = [&](Bits by) { return hn::BitCast(kTag, hn::ShiftLeft<30>(hn::And(by, hn::Set(kBitsTag, 2u)))); };
  sine = hn::Xor(hn::IfThenElse(odd, near_cosine, near_sine), flip(quarter));
  cosine = hn::Xor(hn::IfThenElse(odd, near_sine, near_cosine), flip(hn::Add(quarter, hn::Set(kBitsTag, 1u))));
}

// Writes the values of some lanes, and beyond them what is of no use: the instruction that leaves memory alone there is
// slow on some processors.
HWY_INLINE size_t append(Bits values, hn::Mask<BitsTag> mask, uint32_t* to) {
  hn::StoreU(hn::Compress(values, mask), kBitsTag, to);
  return hn::CountTrue(kBitsTag, mask);
}

size_t move(const WalkArrays& walks, const uint32_t* first, const uint32_t* second, size_t count, bool in_space,
            float reach, uint32_t* beyond) {
  const hn::RebindToSigned<Tag> signed_tag;
  size_t beyond_count = 0;
  for (size_t i = 0; i < count; i += kWidth) {
    const Floats x = hn::LoadU(kTag, walks.x + i), y = hn::LoadU(kTag, walks.y + i), z = hn::LoadU(kTag, walks.z + i);
    const Floats squared = hn::MulAdd(x, x, hn::MulAdd(y, y, hn::Mul(z, z)));
    const auto far = hn::Gt(squared, hn::Set(kTag, reach * reach));
    if (!hn::AllFalse(kTag, far)) {
      const Bits index = hn::Iota(kBitsTag, static_cast<uint32_t>(i));
      beyond_count += append(index, hn::RebindMask(kBitsTag, far), beyond + beyond_count);
    }
    const Floats radius = hn::IfThenZeroElse(far, hn::LoadU(kTag, walks.radius + i));
    Floats sine, cosine;
    sine_cosine(hn::LoadU(kBitsTag, first + i), sine, cosine);
    Floats across = radius;
    if (in_space) {
      // From 31 bits: z in (-1, 1).
      const auto bits = hn::BitCast(signed_tag, hn::LoadU(kBitsTag, second + i));
      const Floats height = hn::Mul(hn::ConvertTo(kTag, bits), hn::Set(kTag, 0x1p-31f));
      const Floats rest = hn::Max(hn::Zero(kTag), hn::NegMulAdd(height, height, hn::Set(kTag, 1.0f)));
      across = hn::Mul(radius, hn::Sqrt(rest));
      hn::StoreU(hn::MulAdd(radius, height, z), kTag, walks.z + i);
    }
    hn::StoreU(hn::MulAdd(across, cosine, x), kTag, walks.x + i);
    hn::StoreU(hn::MulAdd(across, sine, y), kTag, walks.y + i);
  }
  // What lies in the padding does not count.
  while (beyond_count > 0 && beyond[beyond_count - 1] >= count) --beyond_count;
  return beyond_count;
}

size_t arriving(const float* radius, size_t count, float limit, uint32_t* indices) {
  size_t found = 0;
  for (size_t i = 0; i < count; i += kWidth) {
    const auto below = hn::Lt(hn::LoadU(kTag, radius + i), hn::Set(kTag, limit));
    if (hn::AllFalse(kTag, below)) continue;
    const Bits index = hn::Iota(kBitsTag, static_cast<uint32_t>(i));
    found += append(index, hn::RebindMask(kBitsTag, below), indices + found);
  }
  while (found > 0 && indices[found - 1] >= count) --found;
  return found;
}

size_t keep(const WalkArrays& walks, const uint32_t* kept, size_t count) {
  size_t left = 0;
  for (size_t i = 0; i < count; i += kWidth) {
    const auto inside =
        hn::Lt(hn::Iota(kBitsTag, static_cast<uint32_t>(i)), hn::Set(kBitsTag, static_cast<uint32_t>(count)));
    const auto mask = hn::And(inside, hn::Ne(hn::LoadU(kBitsTag, kept + i), hn::Zero(kBitsTag)));
    const auto float_mask = hn::RebindMask(kTag, mask);
    if (left == i && hn::CountTrue(kBitsTag, mask) == kWidth) {
      left += kWidth;  // all are where they stay
      continue;
    }
    // In place: what a vector overwrites has been read.
    for (float* const array : {walks.x, walks.y, walks.z, walks.radius})
      hn::StoreU(hn::Compress(hn::LoadU(kTag, array + i), float_mask), kTag, array + left);
    for (uint32_t* const array : {walks.walk, walks.hint})
      hn::StoreU(hn::Compress(hn::LoadU(kBitsTag, array + i), mask), kBitsTag, array + left);
    left += hn::CountTrue(kBitsTag, mask);
  }
  return left;
}

}  // namespace barycast::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace barycast {
namespace {

HWY_EXPORT(curve_keys);
HWY_EXPORT(counted_numbers);
HWY_EXPORT(independent);
HWY_EXPORT(move);
HWY_EXPORT(arriving);
HWY_EXPORT(keep);

// By the digits of the keys, from the lowest on; equal keys stay in order.
void ranks_by_sorting(const uint32_t* key, size_t count, uint32_t* rank) {
  constexpr uint32_t kDigitBits = 8, kDigits = 1u << kDigitBits;
  std::vector<uint32_t> order(count), next(count);
  std::iota(order.begin(), order.end(), 0u);
  for (uint32_t shift = 0; shift < 32; shift += kDigitBits) {
    const auto digit = [&](uint32_t i) { return key[i] >> shift & (kDigits - 1); };
    std::array<uint32_t, kDigits + 1> begin{};
    for (const uint32_t i : order) ++begin[digit(i) + 1];
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
    for (const uint32_t i : order) next[begin[digit(i)]++] = i;
    std::swap(order, next);
  }
  for (size_t i = 0; i < count; ++i) rank[order[i]] = static_cast<uint32_t>(i);
}

// 2^32 / g and 2^32 / g^2, with g^3 = g + 1; in one dimension g^2 = g + 1.
constexpr std::array<uint32_t, 2> kLatticeSteps = {0xC13FA9A9u, 0x91E10DA5u};
constexpr uint32_t kGoldenStep = 0x9E3779B9u;

}  // namespace

void lattice_numbers(const WalkArrays& walks, std::span<const LatticeWalks> queries, int dimensions,
                     const CurveKeys& keys, uint32_t* first, uint32_t* second) {
  const auto along_curve = [](const LatticeWalks& some) { return some.order == LatticeWalks::kAlongCurve; };
  const std::array<uint32_t, 2> steps = {dimensions == 1 ? kGoldenStep : kLatticeSteps[0], kLatticeSteps[1]};
  if (std::any_of(queries.begin(), queries.end(), along_curve))
    HWY_DYNAMIC_DISPATCH(curve_keys)(walks, queries.back().begin + queries.back().count, keys.fine, keys.coarse);
  HWY_DYNAMIC_DISPATCH(counted_numbers)(queries, keys.coarse, steps, first, second);
  for (const LatticeWalks& some : queries) {
    if (!along_curve(some) || some.count <= kWalksCountedMax) continue;
    ranks_by_sorting(keys.fine + some.begin, some.count, keys.rank);
    for (size_t i = 0; i < some.count; ++i) {
      first[some.begin + i] = keys.rank[i] * steps[0] + some.shift[0];
      second[some.begin + i] = keys.rank[i] * steps[1] + some.shift[1];
    }
  }
}

void independent_numbers(const QueryRandom& random, const uint32_t* walk, size_t count, uint32_t step, uint32_t* first,
                         uint32_t* second) {
  HWY_DYNAMIC_DISPATCH(independent)(random, walk, count, step, first, second);
}

size_t move_walks(const WalkArrays& walks, const uint32_t* first, const uint32_t* second, size_t count, int dimension,
                  float reach, uint32_t* beyond) {
  return HWY_DYNAMIC_DISPATCH(move)(walks, first, second, count, dimension == 3, reach, beyond);
}

size_t find_arriving(const float* radius, size_t count, float limit, uint32_t* indices) {
  return HWY_DYNAMIC_DISPATCH(arriving)(radius, count, limit, indices);
}

size_t keep_walks(const WalkArrays& walks, const uint32_t* kept, size_t count) {
  return HWY_DYNAMIC_DISPATCH(keep)(walks, kept, count);
}

}  // namespace barycast
#endif
