#include <hwy/contrib/math/math-inl.h>

#include <numbers>

#include "base/tolerances.h"
#include "solve/lanes.h"
#include "solve/mean_value_weights.h"

HWY_BEFORE_NAMESPACE();
namespace barycast {
namespace {

using Triangle = MeanValueMesh::Triangle;
using Mask = hn::Mask<hn::FixedTag<double, 4>>;

// Stands for zero in denominators: its square is no underflow, and it is lost beside anything that is not zero.
constexpr double kNearZero = 1e-100;
// Where x lies farther from the triangle, as seen in its plane, than this many heights, the terms of S cancel to the
// square of the reciprocal; they are summed in a form without cancellation instead. Up to there five digits are lost of
// a weight that is small by the same factor. So few triangles are that flat that it takes 1% of the time.
constexpr double kFlat = 300.0;
// Squared distance to the line of an edge, relative to that to its ends, below which three terms of a series suffice.
constexpr double kOnLine = 1e-4;

// (theta / |C| - d / D) / |C|^2 with d = a . b, D = d^2 + |C|^2.
HWY_INLINE Lane angle_curvature(Lane angle, Lane d, Lane crossed, Lane product) {
  const Lane plain = hn::Div(hn::Sub(angle, hn::Div(d, product)), crossed);
  // A thin triangle: its two terms agree. In z = tan^2 theta they are 2/3 - 4/5 z + 6/7 z^2 - ..., over d^3.
  const Lane z = hn::Div(crossed, hn::Mul(d, d));
  const Mask thin = hn::And(hn::Lt(z, all(1.0 / 64)), hn::Gt(d, all(0.0)));
  Lane series = all(20.0 / 21);
  for (int k = 9; k >= 1; --k) series = hn::NegMulAdd(series, z, all(2.0 * k / (2 * k + 1)));
  return hn::IfThenElse(thin, hn::Div(series, hn::Mul(d, hn::Mul(d, d))), plain);
}

// atan2(y, x) of y > 0. hn::Atan would divide once more to reduce its argument: with its polynomial alone, points take
// a tenth less time.
HWY_INLINE Lane angle_of(Lane y, Lane x) {
  const Lane size = hn::Abs(x);
  const Lane least = hn::Min(y, size), most = hn::Max(y, size);
  const Lane part = hn::impl::AtanImpl<double>().AtanPoly(kLaneTag, hn::Div(least, most));
  const Lane acute = hn::IfThenElse(hn::Gt(y, size), hn::Sub(all(std::numbers::pi / 2), part), part);
  return hn::IfThenElse(hn::Lt(x, all(0.0)), hn::Sub(all(std::numbers::pi), acute), acute);
}

// Fills the tables of the edges; returns which points lie on one.
template <bool kGradients>
HWY_INLINE Mask visit_edges(const MeanValueMesh& mesh, MeanValueSums& sums) {
  Mask on_cage = hn::Lt(all(1.0), all(0.0));
  for (size_t i = 0; i < mesh.edges.size(); ++i) {
    const auto& edge = mesh.edges[i];
    const Lane3 a = load3(sums.to_node, edge.from), b = load3(sums.to_node, edge.to), c = cross(a, b);
    // From a x b rather than from an edge direction: it keeps its relative accuracy near the vertices.
    const Lane crossed = hn::Max(dot(c, c), all(kNearZero * kNearZero)), d = dot(a, b);
    const Lane norm = hn::Sqrt(crossed);
    const Lane theta = angle_of(norm, d);
    const Lane angle = hn::Div(theta, norm);
    store3(c, sums.cross, i);
    store(angle, sums.angle, i);
    const double reach = kExactOnCage * edge.length;
    on_cage = hn::Or(on_cage, hn::And(hn::Le(crossed, all(reach * reach)), hn::Le(d, all(0.0))));
    if constexpr (kGradients) {
      const Lane product = hn::MulAdd(d, d, crossed);
      const Lane curvature = angle_curvature(angle, d, crossed, product);
      const Lane inverse = hn::Div(all(1.0), product);
      store(hn::MulAdd(all(edge.length * edge.length / 2), curvature, inverse), sums.fourth_moment, i);
      store3(mul_add(cross(b - a, c), curvature, (a + b) * inverse), sums.angle_slope, i);
    }
  }
  return on_cage;
}

// What an edge adds in flat_sum where x lies near the line of the edge, away from it: p h^2 int dl / ((l^2 + p^2)
// (l^2 + r^2)), the integrand as a series in its small numbers. The general form cancels there to their product.
HWY_INLINE Lane on_line_difference(Lane p, Lane r, Lane h, Lane from, Lane to) {
  const Lane u = hn::Div(all(1.0), from), v = hn::Div(all(1.0), to), uu = hn::Mul(u, u), vv = hn::Mul(v, v);
  const Lane u3 = hn::Mul(uu, u), v3 = hn::Mul(vv, v), u5 = hn::Mul(u3, uu), v5 = hn::Mul(v3, vv);
  const Lane pp = hn::Mul(p, p), rr = hn::Mul(r, r);
  const Lane fourth = hn::Mul(hn::Sub(u3, v3), all(1.0 / 3)), sixth = hn::Mul(hn::Sub(u5, v5), all(1.0 / 5)),
             eighth = hn::Mul(hn::Sub(hn::Mul(u5, uu), hn::Mul(v5, vv)), all(1.0 / 7));
  const Lane second_order = hn::MulAdd(rr, hn::Add(rr, pp), hn::Mul(pp, pp));
  const Lane integral = hn::MulAdd(second_order, eighth, hn::NegMulAdd(hn::Add(rr, pp), sixth, fourth));
  return hn::Mul(hn::Mul(p, hn::Mul(h, h)), integral);
}

// S where x lies in or near the plane of a triangle, outside of it. At h = 0 every p_i E_i is the angle of its edge in
// the plane, with its sign, and they sum to zero. This sums the differences to that, each in a form without
// cancellation: atan(l / p) - atan(l / r) = atan(l (r - p) / (p r + l^2)), r^2 - p^2 = h^2.
HWY_NOINLINE Lane flat_sum(const Triangle& triangle, const MeanValueSums& sums, const Lane h, const Lane p0,
                           const Lane p1, const Lane p2) {
  const Lane signed_p[3] = {p0, p1, p2};
  Lane sum = all(0.0);
  for (size_t i = 0; i < 3; ++i) {
    const Lane3 a = load3(sums.to_node, triangle.node[(i + 1) % 3]),
                b = load3(sums.to_node, triangle.node[(i + 2) % 3]);
    const Lane3 along = cross(all(triangle.rise[i]), all(triangle.normal)) * all(1 / triangle.length[i]);
    const Lane p = hn::Mul(hn::Abs(signed_p[i]), all(1 / triangle.length[i]));
    const Lane r = hn::Sqrt(hn::MulAdd(p, p, hn::Mul(h, h)));
    const Lane excess = hn::Div(hn::Mul(h, h), hn::Add(r, p));  // r - p
    const auto turn = [&](Lane l) HWY_ATTR {
      const Lane below = hn::Max(hn::MulAdd(p, r, hn::Mul(l, l)), all(kNearZero * kNearZero));
      return hn::Atan(kLaneTag, hn::Div(hn::Mul(l, excess), below));
    };
    const Lane from = dot(along, a), to = dot(along, b);
    const Lane angle = hn::Mul(load(sums.angle, triangle.edge[i]), all(triangle.length[i]));
    const Lane difference = hn::MulAdd(excess, angle, hn::Sub(turn(to), turn(from)));
    const Lane least = hn::Min(hn::Abs(from), hn::Abs(to));
    const Mask on_line = hn::Lt(hn::Mul(r, r), hn::Mul(all(kOnLine), hn::Mul(least, least)));
    const Lane line = on_line_difference(p, r, h, from, to);
    sum = hn::Sub(sum, hn::CopySign(hn::IfThenElse(on_line, line, difference), signed_p[i]));
  }
  return sum;
}

// Adds the gradients of the three weights of a triangle. `solid` is W = S / (2 h) = h int |y - x|^-4 dA; its derivative
// along the normal follows from the homogeneity of the integral, that in the plane is an integral along the edges.
HWY_INLINE void add_gradients(const Triangle& triangle, MeanValueSums& sums, Lane h, Lane solid, const Lane (&p)[3],
                              const Lane (&q)[3]) {
  const Lane3 normal = all(triangle.normal);
  Lane along_normal = hn::Div(solid, h);
  Lane3 in_plane = all(Vec<3>(Vec<3>::Zero()));
  for (size_t i = 0; i < 3; ++i) {
    const Lane moment = load(sums.fourth_moment, triangle.edge[i]);
    along_normal = hn::MulAdd(p[i], moment, along_normal);
    in_plane = mul_add(all(triangle.rise[i]), moment, in_plane);
  }
  const Lane3 solid_slope = mul_add(normal, along_normal, in_plane * h);
  const Lane3 slope[3] = {load3(sums.angle_slope, triangle.edge[0]), load3(sums.angle_slope, triangle.edge[1]),
                          load3(sums.angle_slope, triangle.edge[2])};
  const Lane scale = all(1 / (4 * triangle.area)), twice = hn::Add(solid, solid);
  for (size_t k = 0; k < 3; ++k) {
    const size_t next = (k + 1) % 3, last = (k + 2) % 3;
    const Lane3 q_slope = mul_add(slope[next] - slope[k], all(triangle.product[last]),
                                  (slope[last] - slope[k]) * all(triangle.product[next]));
    Lane3 sum = mul_add(all(triangle.rise[k]), twice, solid_slope * hn::Add(p[k], p[k]));
    sum = mul_add(q_slope, h, sum) - normal * q[k];
    add_to3(sum * scale, sums.gradients, triangle.node[k]);
  }
}

// Adds the weights of a triangle; returns which points lie on it, its edges excepted.
template <bool kGradients>
HWY_INLINE Mask visit_triangle(const Triangle& triangle, MeanValueSums& sums) {
  const Lane3 normal = all(triangle.normal);
  const Lane height = dot(normal, load3(sums.to_node, triangle.node[0]));
  const Lane size = hn::Max(hn::Abs(height), all(kNearZero));
  const Lane h = hn::CopySign(size, height), flat = hn::Mul(size, all(-kFlat));
  Lane p[3], angle[3], sum = all(0.0);
  Mask is_flat = hn::Lt(all(1.0), all(0.0)), inside = hn::Eq(size, size);
  for (size_t i = 0; i < 3; ++i) {
    angle[i] = load(sums.angle, triangle.edge[i]);
    p[i] = hn::Mul(dot(normal, load3(sums.cross, triangle.edge[i])), all(triangle.sign[i]));
    sum = hn::MulAdd(p[i], angle[i], sum);
    is_flat = hn::Or(is_flat, hn::Lt(p[i], hn::Mul(flat, all(triangle.length[i]))));
    inside = hn::And(inside, hn::Ge(p[i], all(0.0)));
  }
  if (!hn::AllFalse(kLaneTag, is_flat)) [[unlikely]]
    sum = hn::IfThenElse(is_flat, flat_sum(triangle, sums, h, p[0], p[1], p[2]), sum);

  const Lane full = hn::Div(sum, h), scale = all(1 / (4 * triangle.area));
  // The products of an edge with all three sum to zero: differences spare one, and nothing cancels far away.
  const Lane to_last = hn::Mul(hn::Sub(angle[1], angle[0]), all(triangle.product[2])),
             to_next = hn::Mul(hn::Sub(angle[2], angle[0]), all(triangle.product[1])),
             across = hn::Mul(hn::Sub(angle[2], angle[1]), all(triangle.product[0]));
  const Lane q[3] = {hn::Add(to_last, to_next), hn::Sub(across, to_last), hn::Neg(hn::Add(to_next, across))};
  for (size_t k = 0; k < 3; ++k)
    add_to(hn::Mul(hn::MulAdd(p[k], full, hn::Mul(h, q[k])), scale), sums.weights, triangle.node[k]);
  if constexpr (kGradients) add_gradients(triangle, sums, h, hn::Mul(full, all(0.5)), p, q);
  return hn::And(inside, hn::Le(size, all(kExactOnCage)));
}

template <bool kGradients>
void visit(const MeanValueMesh& mesh, const PointsAtOnce& points, MeanValueSums& sums) {
  const Lane3 x = gather(points);
  Mask on_cage = hn::Lt(x.x, x.x);
  for (size_t i = 0; i < mesh.nodes.size(); ++i) {
    const Lane3 a = all(mesh.nodes[i]) - x;
    on_cage = hn::Or(on_cage, hn::Le(dot(a, a), all(kExactOnCage * kExactOnCage)));
    store3(a, sums.to_node, i);
  }
  on_cage = hn::Or(on_cage, visit_edges<kGradients>(mesh, sums));
  for (const Triangle& triangle : mesh.triangles) on_cage = hn::Or(on_cage, visit_triangle<kGradients>(triangle, sums));
  uint8_t bits[8];
  hn::StoreMaskBits(kLaneTag, on_cage, bits);
  for (size_t i = 0; i < kPointsAtOnce; ++i) sums.on_cage[i] = ((bits[0] >> i) & 1) != 0;
}

}  // namespace

void add_near_weights(const MeanValueMesh& mesh, const PointsAtOnce& points, MeanValueSums& sums) {
  sums.weights.setZero();
  sums.gradients.setZero();
  if (sums.gradients.size() > 0)
    visit<true>(mesh, points, sums);
  else
    visit<false>(mesh, points, sums);
}

}  // namespace barycast
HWY_AFTER_NAMESPACE();
