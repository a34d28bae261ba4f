#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "query/walk_ends.cpp"  // this file, once for every processor
#include "query/walk_ends.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>

#include "query/grid_lanes.h"

#include "query/block_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace barycast::HWY_NAMESPACE {
namespace {

// Newton's steps from the closest point on a triangle that a patch deviates from by less than the thickness: two do for
// floats; the others are for strongly twisted patches.
constexpr int kNewtonSteps = 4;
// Of the Hessian's determinant, with respect to its diagonal: below, parameters are found one at a time.
constexpr float kSingular = 1e-6f;

HWY_INLINE Floats dot(const Point& a, const Point& b) {
  return hn::MulAdd(a.x, b.x, hn::MulAdd(a.y, b.y, hn::Mul(a.z, b.z)));
}
HWY_INLINE Point operator-(const Point& a, const Point& b) {
  return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)};
}
// a s + b
HWY_INLINE Point mul_add(const Point& a, Floats s, const Point& b) {
  return {hn::MulAdd(a.x, s, b.x), hn::MulAdd(a.y, s, b.y), hn::MulAdd(a.z, s, b.z)};
}
HWY_INLINE Floats clamped(Floats x, Floats low, Floats high) {
  return hn::Min(hn::Max(x, low), high);
}

// Of every lane's record: its floats, and its indices.
struct Records {
  const float* base;
  Ints offset;  // in floats
  HWY_INLINE Floats at(size_t k) const { return hn::GatherIndex(kTag, base + k, offset); }
  HWY_INLINE Point point(size_t k) const { return {at(k), at(k + 1), at(k + 2)}; }
};

// Shares of the second and third corner of the closest points on triangles. Slivers may get any.
struct Shares {
  Floats second, third;
};
HWY_INLINE Shares closest_shares(const Point& from_corner, const Point& second, const Point& third) {
  const Floats zero = hn::Zero(kTag), one = hn::Set(kTag, 1.0f);
  const Floats d2 = dot(from_corner, second), d3 = dot(from_corner, third);
  const Floats m22 = dot(second, second), m23 = dot(second, third), m33 = dot(third, third);
  const Floats determinant = hn::MulSub(m22, m33, hn::Mul(m23, m23));
  const Floats in_plane2 = hn::Div(hn::MulSub(m33, d2, hn::Mul(m23, d3)), determinant);
  const Floats in_plane3 = hn::Div(hn::MulSub(m22, d3, hn::Mul(m23, d2)), determinant);
  const auto inside =
      hn::And(hn::And(hn::Ge(in_plane2, zero), hn::Ge(in_plane3, zero)), hn::Le(hn::Add(in_plane2, in_plane3), one));
  Shares best{clamped(hn::Div(d2, m22), zero, one), zero};
  const auto distance = [&](const Shares& at) {
    const Point off{hn::NegMulAdd(at.second, second.x, hn::NegMulAdd(at.third, third.x, from_corner.x)),
                    hn::NegMulAdd(at.second, second.y, hn::NegMulAdd(at.third, third.y, from_corner.y)),
                    hn::NegMulAdd(at.second, second.z, hn::NegMulAdd(at.third, third.z, from_corner.z))};
    return dot(off, off);
  };
  Floats least = distance(best);
  const auto consider = [&](const Shares& other) {
    const Floats squared = distance(other);
    const auto nearer = hn::Lt(squared, least);
    least = hn::Min(squared, least);
    best = {hn::IfThenElse(nearer, other.second, best.second), hn::IfThenElse(nearer, other.third, best.third)};
  };
  consider({zero, clamped(hn::Div(d3, m33), zero, one)});
  const Floats along = hn::Add(hn::Sub(d3, d2), hn::Sub(m22, m23));
  const Floats opposite = hn::Add(hn::Sub(m22, m23), hn::Sub(m33, m23));
  const Floats w = clamped(hn::Div(along, opposite), zero, one);
  consider({hn::Sub(one, w), w});
  return {hn::IfThenElse(inside, in_plane2, best.second), hn::IfThenElse(inside, in_plane3, best.third)};
}

// The closest points of patches, from parameters near them, within windows: closest_on_patch of element_distance.h.
struct Parameters {
  Floats u, v;
};
HWY_INLINE Parameters closest_parameters(const Point& p, const Records& patch, const Parameters& low, Floats size,
                                         Parameters at) {
  const Point from_p = patch.point(0) - p, a = patch.point(3), b = patch.point(6), twist = patch.point(9);
  const Floats u1 = hn::Add(low.u, size), v1 = hn::Add(low.v, size), zero = hn::Zero(kTag);
  // Least along a line: where its direction is nothing, its beginning.
  const auto best = [&](const Point& direction, const Point& from, Floats begin, Floats end) {
    const Floats squared = dot(direction, direction);
    const Floats least = clamped(hn::Div(hn::Neg(dot(direction, from)), squared), begin, end);
    return hn::IfThenElse(hn::Gt(squared, zero), least, begin);
  };
  for (int step = 0; step < kNewtonSteps; ++step) {
    const Point tangent_u = mul_add(twist, at.v, a), tangent_v = mul_add(twist, at.u, b);
    const Point offset = mul_add(a, at.u, mul_add(tangent_v, at.v, from_p));
    const Floats gradient_u = dot(offset, tangent_u), gradient_v = dot(offset, tangent_v);
    const Floats huu = dot(tangent_u, tangent_u), hvv = dot(tangent_v, tangent_v);
    const Floats huv = hn::Add(dot(tangent_u, tangent_v), dot(offset, twist));
    const Floats scale = hn::Mul(huu, hvv), determinant = hn::NegMulAdd(huv, huv, scale);
    const auto regular = hn::Gt(determinant, hn::Mul(scale, hn::Set(kTag, kSingular)));
    const Floats step_u = hn::Div(hn::MulSub(hvv, gradient_u, hn::Mul(huv, gradient_v)), determinant);
    const Floats step_v = hn::Div(hn::MulSub(huu, gradient_v, hn::Mul(huv, gradient_u)), determinant);
    const Floats next_u = hn::IfThenElse(regular, hn::Sub(at.u, step_u), at.u);
    const Floats next_v = hn::IfThenElse(regular, hn::Sub(at.v, step_v), at.v);
    const auto inside =
        hn::And(hn::And(hn::Ge(next_u, low.u), hn::Le(next_u, u1)), hn::And(hn::Ge(next_v, low.v), hn::Le(next_v, v1)));
    const auto done = hn::And(regular, inside);
    at = {next_u, next_v};
    if (hn::AllTrue(kTag, done)) continue;
    const Floats side_v = clamped(next_v, low.v, v1);
    const Floats side_u = best(mul_add(twist, side_v, a), mul_add(b, side_v, from_p), low.u, u1);
    const Floats again_v = best(mul_add(twist, side_u, b), mul_add(a, side_u, from_p), low.v, v1);
    at = {hn::IfThenElse(done, next_u, side_u), hn::IfThenElse(done, next_v, again_v)};
  }
  return at;
}

// The triangle with the least squared bound of a list.
HWY_INLINE uint32_t nearest_of_list(const GridTables& grid, uint32_t cell, const Point& p, float& squared) {
  const std::span<const uint32_t> blocks = grid.blocks_of(cell);
  const auto triangles = [](const BoundBlock& block) {
    return hn::Load(kIntTag, reinterpret_cast<const int32_t*>(block.triangle.data()));
  };
  Floats least = bound(grid.blocks[blocks[0]], p);
  Ints triangle = triangles(grid.blocks[blocks[0]]);
  for (const uint32_t number : blocks.subspan(1)) {
    const BoundBlock& block = grid.blocks[number];
    const Floats squares = bound(block, p);
    const auto nearer = hn::RebindMask(kIntTag, hn::Lt(squares, least));
    triangle = hn::IfThenElse(nearer, triangles(block), triangle);
    least = hn::Min(squares, least);
  }
  const Floats least_of_all = hn::MinOfLanes(kTag, least);
  squared = hn::GetLane(least_of_all);
  const intptr_t lane = hn::FindFirstTrue(kTag, hn::Eq(least, least_of_all));
  HWY_ALIGN uint32_t numbers[kWidth];
  hn::Store(triangle, kIntTag, reinterpret_cast<int32_t*>(numbers));
  return lane < 0 ? kNoTriangle : numbers[lane];  // none, of a point that is not a number
}

// Of up to kWidth walks.
HWY_INLINE void ends_of(const GridTables& grid, const EndTables& tables, const WalkPositions& at, const uint32_t* walks,
                        size_t count, WalkEnd* ends) {
  HWY_ALIGN float position[3][kWidth] = {}, squared[kWidth] = {};
  HWY_ALIGN int32_t triangle[kWidth] = {};
  for (size_t k = 0; k < count; ++k) {
    const uint32_t i = walks[k];
    const std::array<float, 3> p = {at.x[i], at.y[i], at.z[i]};
    for (size_t axis = 0; axis < 3; ++axis) position[axis][k] = p[axis];
    ends[k].triangle = kNoTriangle;
    const uint32_t cell = grid_cell(grid, p);
    if ((cell & kGridFarBit) != 0) continue;
    ends[k].slack = grid.slack(cell);
    ends[k].triangle = nearest_of_list(grid, cell, point_of(p), squared[k]);
    if (ends[k].triangle != kNoTriangle) triangle[k] = static_cast<int32_t>(ends[k].triangle);
  }
  const Point p{hn::Load(kTag, position[0]), hn::Load(kTag, position[1]), hn::Load(kTag, position[2])};
  const Records record{reinterpret_cast<const float*>(tables.triangles.data()),
                       hn::ShiftLeft<4>(hn::Load(kIntTag, triangle))};
  const Shares shares = closest_shares(p - record.point(0), record.point(3), record.point(6));
  Parameters result{shares.second, shares.third};
  const Ints patch = hn::BitCast(kIntTag, record.at(15));
  const auto is_patch = hn::Not(hn::Lt(patch, hn::Zero(kIntTag)));
  if (!hn::AllFalse(kIntTag, is_patch)) {
    const Parameters low{record.at(9), record.at(12)};
    const auto linear = [&](size_t k) {
      return hn::MulAdd(record.at(k + 1), shares.second, hn::MulAdd(record.at(k + 2), shares.third, record.at(k)));
    };
    const Ints twelve = hn::Set(kIntTag, 12);
    const Records patches{reinterpret_cast<const float*>(tables.patches.data()),
                          hn::Mul(hn::IfThenElseZero(is_patch, patch), twelve)};
    const Parameters on_patch = closest_parameters(p, patches, low, record.at(10), {linear(9), linear(12)});
    const auto mask = hn::RebindMask(kTag, is_patch);
    result = {hn::IfThenElse(mask, on_patch.u, result.u), hn::IfThenElse(mask, on_patch.v, result.v)};
  }
  HWY_ALIGN float first[kWidth], second[kWidth], bound[kWidth];
  hn::Store(result.u, kTag, first);
  hn::Store(result.v, kTag, second);
  hn::Store(hn::Sqrt(hn::Load(kTag, squared)), kTag, bound);
  for (size_t k = 0; k < count; ++k) {
    ends[k].first = first[k];
    ends[k].second = second[k];
    ends[k].bound = bound[k];
  }
}

void ends_of_all(const GridTables& grid, const EndTables& tables, const WalkPositions& at, const uint32_t* walks,
                 size_t count, WalkEnd* ends) {
  for (size_t begin = 0; begin < count; begin += kWidth)
    ends_of(grid, tables, at, walks + begin, std::min(kWidth, count - begin), ends + begin);
}

}  // namespace
}  // namespace barycast::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace barycast {
namespace {

HWY_EXPORT(ends_of_all);

void set(float (&to)[3], const Vec<3>& from) {
  for (size_t k = 0; k < 3; ++k) to[k] = static_cast<float>(from[static_cast<Eigen::Index>(k)]);
}

EndTables::Triangle end_triangle(const Cage<3>& cage, const FacetLevels& facets, const FacetTriangle& triangle) {
  EndTables::Triangle result{};
  const auto& c = triangle.corners;
  set(result.corner, c[0]);
  set(result.second, c[1] - c[0]);
  set(result.third, c[2] - c[0]);
  result.patch = EndTables::kNoPatch;
  const Facet& facet = facets.facets[triangle.facet];
  const ElementKind kind = cage.elements()[facet.element].kind;
  if (kind == ElementKind::kTriangle) return result;
  if (kind == ElementKind::kSegment || triangle.part == FacetTriangle::Part::kAll) {
    result.patch = EndTables::kNoEnd;
    return result;
  }
  result.patch = facet.element;
  result.u0 = static_cast<float>(facet.window.u);
  result.v0 = static_cast<float>(facet.window.v);
  // Corners of the first triangle: (0, 0), (1, 0), (1, 1) of the window; of the second: (0, 0), (1, 1), (0, 1).
  const auto side = static_cast<float>(facet.window.size);
  const bool first = triangle.part == FacetTriangle::Part::kFirst;
  result.u2 = side;
  result.u3 = first ? side : 0.0f;
  result.v2 = first ? 0.0f : side;
  result.v3 = side;
  return result;
}

}  // namespace

EndTables make_end_tables(const Cage<3>& cage, const FacetLevels& facets) {
  EndTables tables;
  tables.triangles.reserve(facets.triangles.size());
  for (const FacetTriangle& triangle : facets.triangles)
    tables.triangles.push_back(end_triangle(cage, facets, triangle));
  const auto& elements = cage.elements();
  const auto is_quad = [](const Element& element) { return element.kind == ElementKind::kQuad; };
  if (std::none_of(elements.begin(), elements.end(), is_quad)) return tables;
  tables.patches.resize(elements.size());
  for (size_t e = 0; e < elements.size(); ++e) {
    if (!is_quad(elements[e])) continue;
    const auto& q = patch_of(cage, elements[e]).corner;
    EndTables::Patch& patch = tables.patches[e];
    set(patch.origin, q[0]);
    set(patch.a, q[1] - q[0]);
    set(patch.b, q[3] - q[0]);
    set(patch.twist, q[2] - q[3] - (q[1] - q[0]));
  }
  return tables;
}

void find_ends(const GridTables& grid, const EndTables& tables, const WalkPositions& at, const uint32_t* walks,
               size_t count, WalkEnd* ends) {
  HWY_DYNAMIC_DISPATCH(ends_of_all)(grid, tables, at, walks, count, ends);
}

}  // namespace barycast
#endif
