#include "query/element_distance.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace barycast {
namespace {

template <int D>
ElementPoint<D> at_shares(const Vec<D>& x, const std::array<const Vec<D>*, 3>& corner,
                          const std::array<double, 4>& shares) {
  Vec<D> point = shares[0] * *corner[0] + shares[1] * *corner[1];
  if (corner[2] != nullptr) point += shares[2] * *corner[2];
  return {(point - x).squaredNorm(), point, shares};
}

// Twice the area over the longest edge squared, below which a triangle is a sliver.
constexpr double kSliver = 1e-9;

// A side of a quad shorter than this part of its longest one has its corners in one place, more or less.
constexpr double kCollapsedSide = 0.05;
// More places to start from on such quads, along a parameter.
constexpr int kStarts = 4;

double clamp01(double t) {
  return std::clamp(t, 0.0, 1.0);
}

// The regions that closest_shares decides by are told apart by differences of products that a sliver loses to
// rounding: it acts as its edges, which miss the closest point by its height at most.
TriangleShares closest_on_sliver(const Vec<3>& x, const Vec<3>& a, const Vec<3>& b, const Vec<3>& c) {
  const auto ab = closest_on_segment<3>(x, a, b), ac = closest_on_segment<3>(x, a, c),
             bc = closest_on_segment<3>(x, b, c);
  if (ab.distance_squared <= std::min(ac.distance_squared, bc.distance_squared)) return {ab.shares[1], 0.0};
  if (ac.distance_squared <= bc.distance_squared) return {0.0, ac.shares[1]};
  return {bc.shares[0], bc.shares[1]};
}

}  // namespace

template <int D>
ElementPoint<D> closest_on_segment(const Vec<D>& x, const Vec<D>& a, const Vec<D>& b) {
  const Vec<D> ab = b - a;
  const double squared = ab.squaredNorm();
  const double t = squared > 0 ? clamp01(ab.dot(x - a) / squared) : 0.0;
  return at_shares<D>(x, {&a, &b, nullptr}, {1 - t, t, 0, 0});
}
template ElementPoint<2> closest_on_segment<2>(const Vec<2>&, const Vec<2>&, const Vec<2>&);
template ElementPoint<3> closest_on_segment<3>(const Vec<3>&, const Vec<3>&, const Vec<3>&);

// By the Voronoi regions of vertices, edges and face [Ericson 2005, 5.1.5].
TriangleShares closest_shares(const Vec<3>& x, const Vec<3>& a, const Vec<3>& b, const Vec<3>& c) {
  const Vec<3> ab = b - a, ac = c - a, ax = x - a;
  const double longest = std::max({ab.squaredNorm(), ac.squaredNorm(), (c - b).squaredNorm()});
  if (ab.cross(ac).squaredNorm() < kSliver * kSliver * longest * longest) return closest_on_sliver(x, a, b, c);
  const double d1 = ab.dot(ax), d2 = ac.dot(ax);
  if (d1 <= 0 && d2 <= 0) return {0.0, 0.0};
  const Vec<3> bx = x - b;
  const double d3 = ab.dot(bx), d4 = ac.dot(bx);
  if (d3 >= 0 && d4 <= d3) return {1.0, 0.0};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return {d1 / (d1 - d3), 0.0};
  const Vec<3> cx = x - c;
  const double d5 = ab.dot(cx), d6 = ac.dot(cx);
  if (d6 >= 0 && d5 <= d6) return {0.0, 1.0};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return {0.0, d2 / (d2 - d6)};
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    const double t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    return {1 - t, t};
  }
  const double scale = 1 / (va + vb + vc);
  return {vb * scale, vc * scale};
}

ElementPoint<3> closest_on_triangle(const Vec<3>& x, const Vec<3>& a, const Vec<3>& b, const Vec<3>& c) {
  const TriangleShares shares = closest_shares(x, a, b, c);
  return at_shares<3>(x, {&a, &b, &c}, {shares.first(), shares.second, shares.third, 0});
}

TrianglePairDistance::TrianglePairDistance(const std::array<Vec<3>, 3>& first, const std::array<Vec<3>, 3>& second) {
  origin_ = (first[0] + first[1] + first[2] + second[0] + second[1] + second[2]) / 6;
  for (size_t lane = 0; lane < 8; ++lane) {
    const auto& triangle = lane < 4 ? first : second;
    const size_t k = lane % 4 % 3;
    Vec<3> longest = Vec<3>::UnitX();
    double edge = 0.0;
    for (size_t e = 0; e < 3; ++e)
      if (const Vec<3> side = triangle[(e + 1) % 3] - triangle[e]; side.norm() > edge) {
        longest = side;
        edge = side.norm();
      }
    const Vec<3>&a = triangle[k], &b = triangle[(k + 1) % 3], &c = triangle[(k + 2) % 3];
    const double length = (b - a).norm();
    const Vec<3> along = length > 0 ? Vec<3>((b - a) / length) : Vec<3>(Vec<3>::UnitX());
    const Vec<3> area = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]);
    // A sliver that floats cannot tell from a segment is its edges alone.
    const bool has_inside = area.norm() > 1e-6 * edge * edge;
    has_inside_[lane / 4] = has_inside;
    const Vec<3> normal = has_inside ? Vec<3>(area.normalized()) : longest.unitOrthogonal();
    Vec<3> inward = normal.cross(along);
    if (inward.dot(c - a) < 0) inward = -inward;
    const auto i = static_cast<Eigen::Index>(lane);
    const auto set = [&](Linear& linear, const Vec<3>& direction) {
      for (Eigen::Index axis = 0; axis < 3; ++axis)
        linear.a[static_cast<size_t>(axis)][i] = static_cast<float>(direction[axis]);
      linear.b[i] = static_cast<float>(direction.dot(origin_ - a));
    };
    set(along_, along);
    set(inward_, inward);
    set(normal_, normal);
    length_[i] = static_cast<float>(length);
    size_ = std::max(size_, static_cast<float>((a - origin_).norm()));
  }
}

double TrianglePairDistance::lower_bound(const Vec<3>& x) const {
  const Eigen::Array3f local = (x - origin_).cast<float>();
  const Lanes along = along_(local), inward = inward_(local), normal = normal_(local);
  const Lanes beyond = along - along.max(0.0f).min(length_);
  const Lanes from_edge = beyond * beyond + inward * inward;
  const auto squared = [&](Eigen::Index first) {
    const bool inside = has_inside_[static_cast<size_t>(first / 4)] && inward.segment<4>(first).minCoeff() >= 0.0f;
    return (inside ? 0.0f : from_edge.segment<4>(first).minCoeff()) + normal[first] * normal[first];
  };
  const float distance = std::sqrt(std::min(squared(0), squared(4)));
  // Each linear function is off by a few roundings of its largest term, a sliver by its height.
  return std::max(0.0, static_cast<double>(distance) - 3e-6 * static_cast<double>(distance + size_));
}

BilinearPatch BilinearPatch::part(const PatchWindow& window) const {
  const double u1 = window.u + window.size, v1 = window.v + window.size;
  return {{at(window.u, window.v), at(u1, window.v), at(u1, v1), at(window.u, v1)}};
}

double BilinearPatch::triangle_deviation() const {
  // At equal parameters patch and triangles differ by v (1 - u) T with T the twist vector: T / 4 at most.
  const Vec<3> twist = corner[0] - corner[1] + corner[2] - corner[3];
  const double by_parameters = twist.norm() / 4;
  // Seen along the common normal of the diagonals, a convex quad's diagonals cross. Then every chord of
  // the corners' tetrahedron in that direction runs between the two triangles and the other two faces,
  // and none is longer than the gap between the diagonals; the patch lies inside.
  const Vec<3> diagonal0 = corner[2] - corner[0], diagonal1 = corner[3] - corner[1];
  const Vec<3> normal = diagonal0.cross(diagonal1);
  const double squared = normal.squaredNorm();
  if (!(squared > 0)) return by_parameters;
  const Vec<3> between = corner[1] - corner[0];
  const double s = between.cross(diagonal1).dot(normal) / squared;  // where on diagonal 0
  const double t = between.cross(diagonal0).dot(normal) / squared;  // where on diagonal 1
  if (!(s >= 0 && s <= 1 && t >= 0 && t <= 1)) return by_parameters;
  return std::min(by_parameters, std::abs(between.dot(normal)) / std::sqrt(squared));
}

int BilinearPatch::cuts(double deviation_max, double deviation_of_size, int cuts_max) const {
  double size = 0.0;
  for (size_t i = 0; i < 4; ++i) size = std::max(size, (corner[(i + 1) % 4] - corner[i]).norm());
  // The deviation falls with the square of the part's size.
  double deviation = triangle_deviation();
  int result = 0;
  while (result < cuts_max && (deviation > deviation_of_size * size || deviation > deviation_max)) {
    deviation /= 4;
    size /= 2;
    ++result;
  }
  return result;
}

BilinearPatch patch_of(const Cage<3>& cage, const Element& element) {
  return {{cage.corner(element, 0), cage.corner(element, 1), cage.corner(element, 2), cage.corner(element, 3)}};
}

Vec<2> element_normal(const Cage<2>& cage, const Element& element, const std::array<double, 4>&) {
  const Vec<2> along = cage.corner(element, 1) - cage.corner(element, 0);
  return Vec<2>(along[1], -along[0]).normalized();
}

Vec<3> element_normal(const Cage<3>& cage, const Element& element, const std::array<double, 4>& shares) {
  const Vec<3>& a = cage.corner(element, 0);
  const Vec<3>& b = cage.corner(element, 1);
  const Vec<3>& c = cage.corner(element, 2);
  if (element.kind == ElementKind::kTriangle) return (b - a).cross(c - a).normalized();
  const Vec<3>& d = cage.corner(element, 3);
  const double u = shares[1] + shares[2], v = shares[2] + shares[3];
  const Vec<3> tangent_u = (1 - v) * (b - a) + v * (c - d), tangent_v = (1 - u) * (d - a) + u * (c - b);
  const Vec<3> normal = tangent_u.cross(tangent_v);
  // Where corners coincide the patch has no normal; that of a triangle with area stands in.
  for (const Vec<3>& candidate : {normal, Vec<3>((b - a).cross(c - a)), Vec<3>((c - a).cross(d - a))})
    if (candidate.squaredNorm() > 0) return candidate.normalized();
  return Vec<3>::UnitX();
}

std::vector<PatchWindow> patch_windows(int cuts) {
  const int count = 1 << cuts;
  std::vector<PatchWindow> windows;
  for (int j = 0; j < count; ++j)
    for (int i = 0; i < count; ++i) windows.push_back({double(i) / count, double(j) / count, 1.0 / count});
  return windows;
}

ElementPoint<3> closest_on_patch(const Vec<3>& x, const BilinearPatch& patch, const PatchWindow& window) {
  const BilinearPatch part = window.size == 1.0 ? patch : patch.part(window);
  const auto& c = part.corner;
  const TriangleShares lower = closest_shares(x, c[0], c[1], c[2]), upper = closest_shares(x, c[0], c[2], c[3]);
  const auto from = [&](double u, double v) {
    return closest_on_patch(x, patch, window, window.u + window.size * u, window.v + window.size * v);
  };
  // Where corners (nearly) coincide parameters say little, and Newton may stop short: the sides, which are straight,
  // and more places to start from make up for it.
  ElementPoint<3> best = from(lower.second + lower.third, lower.third);
  const auto consider = [&](const ElementPoint<3>& other) {
    if (other.distance_squared < best.distance_squared) best = other;
  };
  consider(from(upper.second, upper.second + upper.third));
  double shortest = std::numeric_limits<double>::infinity(), longest = 0.0;
  for (size_t i = 0; i < 4; ++i) {
    const double side = (c[(i + 1) % 4] - c[i]).norm();
    shortest = std::min(shortest, side);
    longest = std::max(longest, side);
  }
  if (shortest > kCollapsedSide * longest) return best;
  constexpr std::array<std::array<double, 2>, 4> kCorner = {{{0, 0}, {1, 0}, {1, 1}, {0, 1}}};
  for (size_t i = 0; i < 4; ++i) {
    const size_t j = (i + 1) % 4;
    const double t = closest_on_segment<3>(x, c[i], c[j]).shares[1];
    const double u = (1 - t) * kCorner[i][0] + t * kCorner[j][0], v = (1 - t) * kCorner[i][1] + t * kCorner[j][1];
    const auto shares = patch.shares(window.u + window.size * u, window.v + window.size * v);
    const Vec<3> point = patch.at(window.u + window.size * u, window.v + window.size * v);
    consider({(point - x).squaredNorm(), point, shares});
  }
  for (int i = 1; i < kStarts; ++i)
    for (int j = 1; j < kStarts; ++j) consider(from(double(i) / kStarts, double(j) / kStarts));
  return best;
}

ElementPoint<3> closest_on_patch(const Vec<3>& x, const BilinearPatch& patch, const PatchWindow& window, double u,
                                 double v) {
  // q(u, v) = origin + u a + v b + u v twist
  const Vec<3> a = patch.corner[1] - patch.corner[0], b = patch.corner[3] - patch.corner[0];
  const Vec<3> twist = patch.corner[2] - patch.corner[3] - a;
  const Vec<3> from_x = patch.corner[0] - x;
  const double u0 = window.u, v0 = window.v, u1 = u0 + window.size, v1 = v0 + window.size;

  // With one parameter fixed the patch is a line in the other: exact one-dimensional minima.
  const auto best_u = [&](double at_v) {
    const Vec<3> direction = a + at_v * twist;
    const double squared = direction.squaredNorm();
    return squared > 0 ? std::clamp(-direction.dot(from_x + at_v * b) / squared, u0, u1) : u0;
  };
  const auto best_v = [&](double at_u) {
    const Vec<3> direction = b + at_u * twist;
    const double squared = direction.squaredNorm();
    return squared > 0 ? std::clamp(-direction.dot(from_x + at_u * a) / squared, v0, v1) : v0;
  };
  for (int iteration = 0; iteration < 12; ++iteration) {
    const Vec<3> tangent_u = a + v * twist, tangent_v = b + u * twist;
    const Vec<3> offset = from_x + u * a + v * tangent_v;
    const double gradient_u = offset.dot(tangent_u), gradient_v = offset.dot(tangent_v);
    const double huu = tangent_u.squaredNorm(), hvv = tangent_v.squaredNorm();
    const double huv = tangent_u.dot(tangent_v) + offset.dot(twist);
    const double determinant = huu * hvv - huv * huv;
    double next_u = u, next_v = v;
    if (determinant > 1e-6 * huu * hvv) {
      next_u = u - (hvv * gradient_u - huv * gradient_v) / determinant;
      next_v = v - (huu * gradient_v - huv * gradient_u) / determinant;
    }
    const bool inside = next_u >= u0 && next_u <= u1 && next_v >= v0 && next_v <= v1;
    if (!inside || !(determinant > 1e-6 * huu * hvv)) {
      next_u = best_u(std::clamp(next_v, v0, v1));
      next_v = best_v(next_u);
    }
    const double change = std::abs(next_u - u) + std::abs(next_v - v);
    u = next_u;
    v = next_v;
    if (change <= 1e-12 * window.size) break;
  }
  const auto shares = patch.shares(u, v);
  const Vec<3> point = patch.at(u, v);
  return {(point - x).squaredNorm(), point, shares};
}

}  // namespace barycast
