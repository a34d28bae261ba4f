#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "query/meet_lanes.cpp"  // this file, once for every processor
#include "query/meet_lanes.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <bit>
#include <limits>

HWY_BEFORE_NAMESPACE();
namespace barycast::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using Tag = hn::CappedTag<double, 8>;
using IntTag = hn::RebindToSigned<Tag>;
using Doubles = hn::Vec<Tag>;
using Ints = hn::Vec<IntTag>;
using Mask = hn::Mask<Tag>;
constexpr Tag kTag;
constexpr IntTag kIntTag;
constexpr size_t kWidth = hn::MaxLanes(kTag);

// How far the roots of a patch's quadratic may lie off the patch, in its parameters, and still be hits that
// rounding has moved.
constexpr double kOffPatch = 1e-9;
// A patch whose image is thinner than this part of its length is seen edge-on.
constexpr double kEdgeOn = 1e-12;
// Of an image's distance from the line, with respect to the patch's: what rounding leaves, twice over.
constexpr double kOnLine = 1e-12;

HWY_INLINE Doubles all(double value) {
  return hn::Set(kTag, value);
}

// Across the line, which itself is at 0.
struct Image {
  Doubles x, y;
};
HWY_INLINE Image operator-(const Image& a, const Image& b) {
  return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y)};
}
HWY_INLINE Doubles dot(const Image& a, const Image& b) {
  return hn::MulAdd(a.x, b.x, hn::Mul(a.y, b.y));
}
// a + (b - a) at, exactly a and b at the ends.
HWY_INLINE Image between(const Image& a, const Image& b, Doubles at) {
  const Doubles rest = hn::Sub(all(1), at);
  return {hn::MulAdd(at, b.x, hn::Mul(rest, a.x)), hn::MulAdd(at, b.y, hn::Mul(rest, a.y))};
}
HWY_INLINE Doubles clamped(Doubles x) {
  return hn::Min(hn::Max(x, hn::Zero(kTag)), all(1));
}

// Without cancellation, good to two units in the last place [Kahan]: of an element seen edge-on nothing else
// would be left.
HWY_INLINE Doubles cross(const Image& a, const Image& b) {
  const Doubles q = hn::Mul(a.y, b.x);
  return hn::Sub(hn::MulSub(a.x, b.y, q), hn::MulSub(a.y, b.x, q));
}

// Of a sequence of three, which the largest coordinate of the line's direction ends.
struct Axes {
  Mask last_is_x, last_is_y;
  template <class T, class M>
  static HWY_INLINE T pick(M x, M y, T if_x, T if_y, T if_z) {
    return hn::IfThenElse(x, if_x, hn::IfThenElse(y, if_y, if_z));
  }
  HWY_INLINE Doubles first(Doubles x, Doubles y, Doubles z) const { return pick(last_is_x, last_is_y, y, z, x); }
  HWY_INLINE Doubles second(Doubles x, Doubles y, Doubles z) const { return pick(last_is_x, last_is_y, z, x, y); }
  HWY_INLINE Doubles last(Doubles x, Doubles y, Doubles z) const { return pick(last_is_x, last_is_y, x, y, z); }
};
struct Point {
  Doubles first, second, last;  // along the line's axes
};
HWY_INLINE Point along(const Axes& axes, Doubles x, Doubles y, Doubles z) {
  return {axes.first(x, y, z), axes.second(x, y, z), axes.last(x, y, z)};
}

// A line and an element in every lane.
template <int kCorners>
struct Candidates {
  Axes axes;
  Point origin, direction;
  Point corner[kCorners];
  Image image[kCorners];  // sheared, not a perpendicular view
};

template <int kCorners>
HWY_INLINE void gather(const double* corners, const Vec<3>& origin, const double* directions, Ints line, Ints element,
                       Candidates<kCorners>& out) {
  const Ints direction = hn::Add(line, hn::ShiftLeft<1>(line));
  const Doubles x = hn::GatherIndex(kTag, directions, direction), y = hn::GatherIndex(kTag, directions + 1, direction),
                z = hn::GatherIndex(kTag, directions + 2, direction);
  const Doubles ax = hn::Abs(x), ay = hn::Abs(y), az = hn::Abs(z);
  out.axes.last_is_x = hn::And(hn::Ge(ax, ay), hn::Ge(ax, az));
  out.axes.last_is_y = hn::AndNot(out.axes.last_is_x, hn::Ge(ay, az));
  out.direction = along(out.axes, x, y, z);
  out.origin = along(out.axes, all(origin[0]), all(origin[1]), all(origin[2]));
  const Doubles shear0 = hn::Div(out.direction.first, out.direction.last);
  const Doubles shear1 = hn::Div(out.direction.second, out.direction.last);

  const auto last_is_x = hn::RebindMask(kIntTag, out.axes.last_is_x);
  const auto last_is_y = hn::RebindMask(kIntTag, out.axes.last_is_y);
  const auto axis = [&](int64_t if_x, int64_t if_y, int64_t if_z) {
    return hn::Add(hn::ShiftLeft<4>(element), Axes::pick(last_is_x, last_is_y, hn::Set(kIntTag, if_x),
                                                         hn::Set(kIntTag, if_y), hn::Set(kIntTag, if_z)));
  };
  const Ints first = axis(1, 2, 0), second = axis(2, 0, 1), last = axis(0, 1, 2);
  for (int c = 0; c < kCorners; ++c) {
    const double* const base = corners + 4 * c;
    Point& corner = out.corner[c];
    corner = {hn::GatherIndex(kTag, base, first), hn::GatherIndex(kTag, base, second),
              hn::GatherIndex(kTag, base, last)};
    const Doubles depth = hn::Sub(corner.last, out.origin.last);
    out.image[c] = {hn::NegMulAdd(shear0, depth, hn::Sub(corner.first, out.origin.first)),
                    hn::NegMulAdd(shear1, depth, hn::Sub(corner.second, out.origin.second))};
  }
}

// Whether the boundary winds around the line: its crossings of the ray to the right of it. The line is moved by
// (e, e^2) for an infinitesimal e, and signs are exact.
template <int kCorners>
HWY_INLINE Mask winds_around(const Image (&corner)[kCorners]) {
  Mask above[kCorners];
  for (int i = 0; i < kCorners; ++i) above[i] = hn::Gt(corner[i].y, hn::Zero(kTag));
  Doubles turns = hn::Zero(kTag);
  for (int i = 0; i < kCorners; ++i) {
    const int j = (i + 1) % kCorners;
    const Image &a = corner[i], &b = corner[j];
    // On the left of an edge from a to b: rounding is monotonic, and products that round to the same differ in what
    // they lost, or not at all.
    const Doubles p = hn::Mul(a.x, b.y), q = hn::Mul(a.y, b.x);
    Mask left = hn::Gt(p, q);
    const Mask same = hn::Eq(p, q);
    if (!hn::AllFalse(kTag, same)) {
      const Doubles p_rest = hn::MulSub(a.x, b.y, p), q_rest = hn::MulSub(a.y, b.x, q);
      // One end is above, the other is not.
      const Mask moved = hn::And(hn::Eq(p_rest, q_rest), hn::Gt(a.y, b.y));
      left = hn::Or(left, hn::And(same, hn::Or(hn::Gt(p_rest, q_rest), moved)));
    }
    const Mask up = hn::And(hn::AndNot(above[i], above[j]), left);
    const Mask down = hn::AndNot(left, hn::AndNot(above[j], above[i]));
    turns = hn::Add(turns, hn::IfThenElseZero(up, all(1)));
    turns = hn::Sub(turns, hn::IfThenElseZero(down, all(1)));
  }
  return hn::Ne(turns, hn::Zero(kTag));
}

struct Shares {
  Doubles of[4];
};

// Shares of the corners of a triangle around the line; signs are known to agree, values may be off by
// rounding.
HWY_INLINE Shares triangle_shares(const Image (&image)[3]) {
  const Doubles s0 = hn::Abs(cross(image[1], image[2])), s1 = hn::Abs(cross(image[2], image[0])),
                s2 = hn::Abs(cross(image[0], image[1]));
  const Doubles sum = hn::Add(hn::Add(s0, s1), s2);
  // Seen edge-on to the last bit: any point of it is as good.
  const Mask seen = hn::Gt(sum, hn::Zero(kTag));
  const auto share = [&](Doubles s) { return hn::IfThenElse(seen, hn::Div(s, sum), all(1.0 / 3)); };
  return {{share(s0), share(s1), share(s2), hn::Zero(kTag)}};
}

// Parameters of a patch where its image is the line, and how far they lie off the patch.
struct Root {
  Doubles u, v, off;
};
HWY_INLINE Root root_at(const Image (&q)[4], Doubles u) {
  const Image from = between(q[0], q[1], u), across = between(q[3], q[2], u) - from;
  const Doubles squared = dot(across, across);
  const Mask known = hn::And(hn::IsFinite(u), hn::Gt(squared, hn::Zero(kTag)));
  const Doubles v = hn::IfThenElse(known, hn::Div(hn::Neg(dot(from, across)), squared), all(0.5));
  const auto beyond = [](Doubles x) { return hn::Max(hn::Neg(x), hn::Sub(x, all(1))); };
  return {u, v, hn::Max(beyond(u), beyond(v))};
}

// For fixed u the patch is a segment from A(u) to B(u); it passes the line where cross(A, B), a quadratic
// in u, is zero.
struct Roots {
  Root better, worse;
  // Two roots apart; otherwise they are where the quadratic comes nearest to zero, or the patch is seen
  // edge-on and they are rounding.
  Mask distinct;
};
HWY_INLINE Roots patch_roots(const Image (&q)[4], Doubles size) {
  const Doubles zero = hn::Zero(kTag);
  const Doubles at0 = cross(q[0], q[3]), at1 = cross(q[1], q[2]);
  const Doubles middle = hn::Add(cross(q[0], q[2]), cross(q[1], q[3]));
  const Doubles a = hn::Add(hn::Sub(at0, middle), at1), b = hn::NegMulAdd(all(2), at0, middle);
  const Doubles discriminant = hn::MulSub(b, b, hn::Mul(hn::Mul(all(4), a), at0));
  const Doubles root = hn::Sqrt(hn::Max(zero, discriminant));
  const Doubles h = hn::Mul(all(-0.5), hn::Add(b, hn::CopySign(root, b)));  // no cancellation
  const Doubles infinity = all(std::numeric_limits<double>::infinity());
  const Doubles u0 = hn::IfThenElse(hn::Ne(a, zero), hn::Div(h, a), infinity);
  const Doubles other = hn::IfThenElseZero(hn::Ne(h, zero), hn::Div(at0, h));
  const Root r0 = root_at(q, u0), r1 = root_at(q, hn::IfThenElse(hn::Lt(discriminant, zero), u0, other));
  const Mask second = hn::Lt(r1.off, r0.off);
  const auto choose = [&](const Root& if_second, const Root& otherwise) -> Root {
    return {hn::IfThenElse(second, if_second.u, otherwise.u), hn::IfThenElse(second, if_second.v, otherwise.v),
            hn::IfThenElse(second, if_second.off, otherwise.off)};
  };
  const Doubles thin = hn::Mul(all(kEdgeOn), size);
  return {choose(r1, r0), choose(r0, r1), hn::Gt(discriminant, hn::Mul(thin, thin))};
}

HWY_INLINE Shares patch_shares(Doubles u, Doubles v) {
  const Doubles rest_u = hn::Sub(all(1), u), rest_v = hn::Sub(all(1), v);
  return {{hn::Mul(rest_u, rest_v), hn::Mul(u, rest_v), hn::Mul(u, v), hn::Mul(rest_u, v)}};
}

// Shares at a root, on the patch. Where the patch is seen nearly edge-on the quadratic knows little of the
// root; then exact minima along u and v in turn, which need few turns on a sliver, bring it to the line.
HWY_INLINE Shares shares_at(const Image (&q)[4], Doubles size, const Root& root, Mask asked) {
  Doubles u = clamped(root.u), v = clamped(root.v);
  const auto nearest = [](const Image& from, const Image& to, Doubles otherwise) {
    const Image way = to - from;
    const Doubles squared = dot(way, way);
    return hn::IfThenElse(hn::Gt(squared, hn::Zero(kTag)), clamped(hn::Div(hn::Neg(dot(from, way)), squared)),
                          otherwise);
  };
  const Doubles enough = hn::Mul(all(kOnLine * kOnLine), size);
  Mask open = asked;
  for (int turn = 0; turn < 16; ++turn) {
    const Image image = between(between(q[0], q[1], u), between(q[3], q[2], u), v);
    open = hn::AndNot(hn::Le(dot(image, image), enough), open);
    if (hn::AllFalse(kTag, open)) break;
    u = hn::IfThenElse(open, nearest(between(q[0], q[3], v), between(q[1], q[2], v), u), u);
    v = hn::IfThenElse(open, nearest(between(q[0], q[1], u), between(q[3], q[2], u), v), v);
  }
  return patch_shares(u, v);
}

// The hits of every lane, and the candidates that they are of.
struct HitLanes {
  alignas(64) double t[kWidth], share[4][kWidth], point[3][kWidth];
  uint32_t lanes;
};

HWY_INLINE uint32_t bits_of(Mask mask) {
  std::array<uint8_t, 8> bits{};
  hn::StoreMaskBits(kTag, mask, bits.data());
  return bits[0];
}

template <int kCorners>
HWY_INLINE void store(const Candidates<kCorners>& at, const Shares& shares, Mask hit, double from, HitLanes& out) {
  const auto sum = [&](Doubles Point::*coordinate) {
    Doubles result = hn::Mul(shares.of[0], at.corner[0].*coordinate);
    for (int c = 1; c < kCorners; ++c) result = hn::MulAdd(shares.of[c], at.corner[c].*coordinate, result);
    return result;
  };
  const Doubles p0 = sum(&Point::first), p1 = sum(&Point::second), p2 = sum(&Point::last);
  const Doubles t = hn::MulAdd(at.direction.first, hn::Sub(p0, at.origin.first),
                               hn::MulAdd(at.direction.second, hn::Sub(p1, at.origin.second),
                                          hn::Mul(at.direction.last, hn::Sub(p2, at.origin.last))));
  out.lanes = bits_of(hn::And(hit, hn::Gt(t, all(from))));
  hn::Store(t, kTag, out.t);
  for (int c = 0; c < 4; ++c) hn::Store(shares.of[c], kTag, out.share[c]);
  const auto pick = [&](Doubles if_x, Doubles if_y, Doubles if_z) {
    return Axes::pick(at.axes.last_is_x, at.axes.last_is_y, if_x, if_y, if_z);
  };
  hn::Store(pick(p2, p1, p0), kTag, out.point[0]);
  hn::Store(pick(p0, p2, p1), kTag, out.point[1]);
  hn::Store(pick(p1, p0, p2), kTag, out.point[2]);
}

HWY_INLINE void append(const HitLanes& from, size_t k, const LineCandidate& candidate, std::vector<LineHit<3>>& hits) {
  hits.push_back({from.t[k],
                  candidate.element,
                  candidate.line,
                  {from.share[0][k], from.share[1][k], from.share[2][k], from.share[3][k]},
                  {from.point[0][k], from.point[1][k], from.point[2][k]}});
}

template <bool kQuads>
void meet(std::span<const ElementCorners> corners, const Vec<3>& origin, std::span<const Vec<3>> directions,
          std::span<const LineCandidate> candidates, double from, std::vector<LineHit<3>>& hits) {
  constexpr int kCorners = kQuads ? 4 : 3;
  const double* const coordinates = corners.data()->coordinate.data();
  HitLanes first, second;
  for (size_t begin = 0; begin < candidates.size(); begin += kWidth) {
    const size_t count = std::min(kWidth, candidates.size() - begin);
    HWY_ALIGN int64_t line[kWidth] = {}, element[kWidth] = {};
    for (size_t k = 0; k < count; ++k) {
      line[k] = candidates[begin + k].line;
      element[k] = candidates[begin + k].element;
    }
    Candidates<kCorners> at;
    gather(coordinates, origin, directions.data()->data(), hn::Load(kIntTag, line), hn::Load(kIntTag, element), at);
    const Mask asked = hn::FirstN(kTag, count);
    Mask hit = hn::And(asked, winds_around(at.image));
    second.lanes = 0;
    if constexpr (kQuads) {
      const Image diagonal0 = at.image[2] - at.image[0], diagonal1 = at.image[3] - at.image[1];
      const Doubles size = hn::Add(dot(diagonal0, diagonal0), dot(diagonal1, diagonal1));
      const Roots roots = patch_roots(at.image, size);
      // Otherwise the image folds over the line, or misses it: two hits or none, never one.
      const Mask twice =
          hn::And(hn::AndNot(hit, asked), hn::And(roots.distinct, hn::Le(roots.worse.off, all(kOffPatch))));
      hit = hn::Or(hit, twice);
      if (hn::AllFalse(kTag, hit)) continue;
      store(at, shares_at(at.image, size, roots.better, hit), hit, from, first);
      if (!hn::AllFalse(kTag, twice)) store(at, shares_at(at.image, size, roots.worse, twice), twice, from, second);
    } else {
      if (hn::AllFalse(kTag, hit)) continue;
      store(at, triangle_shares(at.image), hit, from, first);
    }
    for (uint32_t lanes = first.lanes | second.lanes; lanes != 0; lanes &= lanes - 1) {
      const auto k = static_cast<size_t>(std::countr_zero(lanes));
      if ((first.lanes >> k & 1) != 0) append(first, k, candidates[begin + k], hits);
      if ((second.lanes >> k & 1) != 0) append(second, k, candidates[begin + k], hits);
    }
  }
}

void meet_quads(std::span<const ElementCorners> corners, const Vec<3>& origin, std::span<const Vec<3>> directions,
                std::span<const LineCandidate> candidates, double from, std::vector<LineHit<3>>& hits) {
  meet<true>(corners, origin, directions, candidates, from, hits);
}
void meet_triangles(std::span<const ElementCorners> corners, const Vec<3>& origin, std::span<const Vec<3>> directions,
                    std::span<const LineCandidate> candidates, double from, std::vector<LineHit<3>>& hits) {
  meet<false>(corners, origin, directions, candidates, from, hits);
}

}  // namespace
}  // namespace barycast::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace barycast {
namespace {

HWY_EXPORT(meet_quads);
HWY_EXPORT(meet_triangles);

}  // namespace

ElementCorners corners_of(const Cage<3>& cage, const Element& element) {
  ElementCorners result{};
  for (int c = 0; c < element.corner_count(); ++c)
    for (int k = 0; k < 3; ++k) result.coordinate[static_cast<size_t>(4 * c + k)] = cage.corner(element, c)[k];
  return result;
}

std::vector<ElementCorners> corners_of(const Cage<3>& cage) {
  std::vector<ElementCorners> result;
  result.reserve(cage.elements().size());
  for (const Element& element : cage.elements()) result.push_back(corners_of(cage, element));
  return result;
}

void meet_candidates(std::span<const ElementCorners> corners, bool quads, const Vec<3>& origin,
                     std::span<const Vec<3>> directions, std::span<const LineCandidate> candidates, double from,
                     std::vector<LineHit<3>>& hits) {
  if (quads)
    HWY_DYNAMIC_DISPATCH(meet_quads)(corners, origin, directions, candidates, from, hits);
  else
    HWY_DYNAMIC_DISPATCH(meet_triangles)(corners, origin, directions, candidates, from, hits);
}

}  // namespace barycast
#endif
