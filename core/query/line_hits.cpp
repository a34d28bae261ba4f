#include "query/line_hits.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace barycast {
namespace {

// How far the roots of a patch's quadratic may lie off the patch, in its parameters, and still be hits that
// rounding has moved.
constexpr double kOffPatch = 1e-9;
// A patch whose image is thinner than this part of its length is seen edge-on.
constexpr double kEdgeOn = 1e-12;

// Without cancellation, good to two units in the last place [Kahan]: of an element seen edge-on nothing else
// would be left.
double cross(const Vec<2>& a, const Vec<2>& b) {
  const double q = a[1] * b[0];
  return std::fma(a[0], b[1], -q) - std::fma(a[1], b[0], -q);
}

// Which side of the line through a and b the origin is on: +1 left, -1 right. Exact, with the origin
// moved by (e, e^2) for an infinitesimal e, so that it is 0 for a = b alone.
int side(const Vec<2>& a, const Vec<2>& b) {
  const double p = a[0] * b[1], q = a[1] * b[0];
  if (p != q) return p > q ? 1 : -1;  // rounding is monotonic
  const double p_rest = std::fma(a[0], b[1], -p), q_rest = std::fma(a[1], b[0], -q);
  if (p_rest != q_rest) return p_rest > q_rest ? 1 : -1;
  if (a[1] != b[1]) return a[1] > b[1] ? 1 : -1;
  if (a[0] != b[0]) return b[0] > a[0] ? 1 : -1;
  return 0;
}

// How often a closed polygon winds around the moved origin, by its crossings of the ray to the right.
int winding(const Vec<2>* corner, int count) {
  int result = 0;
  for (int i = 0; i < count; ++i) {
    const Vec<2>&a = corner[i], &b = corner[(i + 1) % count];
    const bool a_above = a[1] > 0, b_above = b[1] > 0;
    if (a_above == b_above) continue;
    if (b_above && side(a, b) > 0) ++result;
    if (a_above && side(a, b) < 0) --result;
  }
  return result;
}

// Shares of the corners of a triangle around the origin; signs are known to agree, values may be off by
// rounding.
std::array<double, 4> triangle_shares(const Vec<2>* image) {
  std::array<double, 4> shares = {std::abs(cross(image[1], image[2])), std::abs(cross(image[2], image[0])),
                                  std::abs(cross(image[0], image[1])), 0};
  const double sum = shares[0] + shares[1] + shares[2];
  // Seen edge-on to the last bit: any point of it is as good.
  if (!(sum > 0)) return {1.0 / 3, 1.0 / 3, 1.0 / 3, 0};
  for (double& share : shares) share /= sum;
  return shares;
}

// Parameters of a patch where its image is the origin.
struct PatchRoot {
  double u, v;
  double off() const { return std::max({-u, u - 1, -v, v - 1}); }
};

std::array<double, 4> patch_shares(double u, double v) {
  return {(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v};
}

// Shares at a root, on the patch. Where the patch is seen nearly edge-on the quadratic knows little of the
// root; then exact minima along u and v in turn, which need few turns on a sliver, bring it to the line.
std::array<double, 4> shares_at(const Vec<2>* q, const PatchRoot& root) {
  double u = std::clamp(root.u, 0.0, 1.0), v = std::clamp(root.v, 0.0, 1.0);
  const double size = (q[2] - q[0]).squaredNorm() + (q[3] - q[1]).squaredNorm();
  const auto nearest = [](const Vec<2>& from, const Vec<2>& to, double otherwise) {
    const double squared = (to - from).squaredNorm();
    return squared > 0 ? std::clamp(-from.dot(to - from) / squared, 0.0, 1.0) : otherwise;
  };
  for (int turn = 0; turn < 16; ++turn) {
    const auto s = patch_shares(u, v);
    const Vec<2> image = s[0] * q[0] + s[1] * q[1] + s[2] * q[2] + s[3] * q[3];
    if (image.squaredNorm() <= 1e-24 * size) break;
    u = nearest((1 - v) * q[0] + v * q[3], (1 - v) * q[1] + v * q[2], u);
    v = nearest((1 - u) * q[0] + u * q[1], (1 - u) * q[3] + u * q[2], v);
  }
  return patch_shares(u, v);
}

// For fixed u the patch is a segment from A(u) to B(u); it passes the origin where cross(A, B), a quadratic
// in u, is zero.
struct PatchRoots {
  std::array<PatchRoot, 2> root;  // in no particular order
  // Two roots apart; otherwise they are where the quadratic comes nearest to zero, or the patch is seen
  // edge-on and they are rounding.
  bool distinct;
};

PatchRoots patch_roots(const Vec<2>* q) {
  const double at0 = cross(q[0], q[3]), at1 = cross(q[1], q[2]);
  const double between = cross(q[0], q[2]) + cross(q[1], q[3]);
  const double a = at0 - between + at1, b = between - 2 * at0;
  const double discriminant = b * b - 4 * a * at0;
  const double root = std::sqrt(std::max(0.0, discriminant));
  const double h = -0.5 * (b + std::copysign(root, b));  // no cancellation
  const double u0 = a != 0 ? h / a : std::numeric_limits<double>::infinity();
  const double u1 = discriminant < 0 ? u0 : h != 0 ? at0 / h : 0.0;
  const auto with_v = [&](double u) -> PatchRoot {
    if (!std::isfinite(u)) return {u, 0.5};
    const Vec<2> from = (1 - u) * q[0] + u * q[1], along = (1 - u) * q[3] + u * q[2] - from;
    const double squared = along.squaredNorm();
    return {u, squared > 0 ? -from.dot(along) / squared : 0.5};
  };
  const double area = (q[2] - q[0]).squaredNorm() + (q[3] - q[1]).squaredNorm();
  return {{with_v(u0), with_v(u1)}, discriminant > kEdgeOn * kEdgeOn * area * area};
}

template <int D>
LineHit<D> hit_at(const Line<D>& line, const Cage<D>& cage, uint32_t index, const std::array<double, 4>& shares) {
  const Element& element = cage.elements()[index];
  Vec<D> point = Vec<D>::Zero();
  for (int i = 0; i < element.corner_count(); ++i) point += shares[static_cast<size_t>(i)] * cage.corner(element, i);
  return {line.direction().dot(point - line.origin()), index, shares, point};
}

}  // namespace

template <int D>
Line<D>::Line(const Vec<D>& origin, const Vec<D>& direction) : origin_(origin), direction_(direction) {
  if constexpr (D == 3) {
    Eigen::Index largest = 0;
    direction.cwiseAbs().maxCoeff(&largest);
    const int last = static_cast<int>(largest);
    axis_ = {(last + 1) % 3, (last + 2) % 3, last};
    shear_ = {direction[axis_[0]] / direction[last], direction[axis_[1]] / direction[last]};
  }
}

// Every call must give the same bits for the same point, wherever it is inlined: fma is spelt out.
template <int D>
typename Line<D>::Image Line<D>::image(const Vec<D>& point) const {
  const Vec<D> from_origin = point - origin_;
  if constexpr (D == 3) {
    const double along = from_origin[axis_[2]];
    return {std::fma(-shear_[0], along, from_origin[axis_[0]]), std::fma(-shear_[1], along, from_origin[axis_[1]])};
  } else {
    const double other = direction_[1] * from_origin[0];
    return Image(std::fma(direction_[0], from_origin[1], -other));
  }
}

template <int D>
int meet(const Line<D>& line, const Cage<D>& cage, uint32_t index, std::array<LineHit<D>, 2>& hits) {
  const Element& element = cage.elements()[index];
  std::array<typename Line<D>::Image, 4> image;
  const int count = element.corner_count();
  for (int i = 0; i < count; ++i) image[static_cast<size_t>(i)] = line.image(cage.corner(element, i));
  if constexpr (D == 2) {
    const double a = image[0][0], b = image[1][0];
    if ((a > 0) == (b > 0)) return 0;
    hits[0] = hit_at(line, cage, index, {b / (b - a), a / (a - b), 0, 0});
    return 1;
  } else {
    const int turns = winding(image.data(), count);
    if (element.kind == ElementKind::kTriangle) {
      if (turns == 0) return 0;
      hits[0] = hit_at(line, cage, index, triangle_shares(image.data()));
      return 1;
    }
    auto [roots, distinct] = patch_roots(image.data());
    if (roots[1].off() < roots[0].off()) std::swap(roots[0], roots[1]);
    if (turns != 0) {
      hits[0] = hit_at(line, cage, index, shares_at(image.data(), roots[0]));
      return 1;
    }
    // The image folds over the line, or misses it: two hits or none, never one.
    if (!distinct || !(roots[1].off() <= kOffPatch)) return 0;
    for (size_t i = 0; i < 2; ++i) hits[i] = hit_at(line, cage, index, shares_at(image.data(), roots[i]));
    return 2;
  }
}

template class Line<2>;
template class Line<3>;
template int meet(const Line<2>&, const Cage<2>&, uint32_t, std::array<LineHit<2>, 2>&);
template int meet(const Line<3>&, const Cage<3>&, uint32_t, std::array<LineHit<3>, 2>&);

}  // namespace barycast
