#include "query/winding.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "query/element_distance.h"

namespace barycast {
namespace {

constexpr uint32_t kLeafFacets = 8;
// A cluster this many radii away acts as its dipole; the next term is smaller by the square of it.
constexpr double kFarRadii = 3.0;
// Quads are cut into triangles that follow the patch about as closely as the default thickness.
constexpr double kPatchDeviation = 1e-3;

// Normal times area (length), outwards for counter-clockwise facets.
Vec<2> area_vector(const std::array<Vec<2>, 2>& s) {
  return {s[1][1] - s[0][1], s[0][0] - s[1][0]};
}
Vec<3> area_vector(const std::array<Vec<3>, 3>& t) {
  return 0.5 * (t[1] - t[0]).cross(t[2] - t[0]);
}

// A number whose angle is that under which x sees a segment, or half of that under which it sees a triangle, signed
// [van Oosterom and Strackee 1983].
struct Turn {
  double cosine, sine;  // times a length
};
Turn turn(const std::array<Vec<2>, 2>& s, const Vec<2>& x) {
  const Vec<2> a = s[0] - x, b = s[1] - x;
  return {a.dot(b), a[0] * b[1] - a[1] * b[0]};
}
Turn turn(const std::array<Vec<3>, 3>& t, const Vec<3>& x) {
  const Vec<3> a = t[0] - x, b = t[1] - x, c = t[2] - x;
  const double la = a.norm(), lb = b.norm(), lc = c.norm();
  return {la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb, a.dot(b.cross(c))};
}

// The sum of the angles of some turns, over 2 pi: that of their product, and the whole turns that it has lost.
template <class Facet, class Point>
double turned(const Facet* begin, const Facet* end, const Point& x) {
  double cosine = 1.0, sine = 0.0;
  int whole = 0;
  for (const Facet* facet = begin; facet != end; ++facet) {
    const Turn by = turn(*facet, x);
    if (by.cosine == 0 && by.sine == 0) continue;  // x is a corner of it
    const double next = sine * by.cosine + cosine * by.sine;
    if (sine >= 0 && by.sine >= 0 && next < 0) ++whole;
    if (sine < 0 && by.sine < 0 && next >= 0) --whole;
    cosine = cosine * by.cosine - sine * by.sine;
    sine = next;
  }
  return whole + std::atan2(sine, cosine) / (2 * std::numbers::pi);
}

double dipole_field(const Vec<2>& to_centre, const Vec<2>& dipole) {
  return dipole.dot(to_centre) / (2 * std::numbers::pi * to_centre.squaredNorm());
}
double dipole_field(const Vec<3>& to_centre, const Vec<3>& dipole) {
  const double squared = to_centre.squaredNorm();
  return dipole.dot(to_centre) / (4 * std::numbers::pi * squared * std::sqrt(squared));
}

}  // namespace

template <int D>
WindingNumber<D>::WindingNumber(const Cage<D>& cage) {
  for (const Element& element : cage.elements()) {
    if constexpr (D == 2) {
      facets_.push_back({cage.corner(element, 0), cage.corner(element, 1)});
    } else if (element.kind == ElementKind::kTriangle) {
      facets_.push_back({cage.corner(element, 0), cage.corner(element, 1), cage.corner(element, 2)});
    } else if (element.kind == ElementKind::kQuad) {
      const BilinearPatch patch = patch_of(cage, element);
      for (const PatchWindow& window : patch_windows(patch.cuts(kPatchDeviation, 1.0, 4))) {
        const auto corner = patch.part(window).corner;
        facets_.push_back({corner[0], corner[1], corner[2]});
        facets_.push_back({corner[0], corner[2], corner[3]});
      }
    }
  }
  if (!facets_.empty()) build(0, static_cast<uint32_t>(facets_.size()));
}

template <int D>
uint32_t WindingNumber<D>::build(uint32_t begin, uint32_t end) {
  Node node{.begin = begin, .end = end};
  const auto mean = [](const Facet& facet) {
    Vec<D> sum = facet[0] + facet[1];
    if constexpr (D == 3) sum += facet[2];
    return Vec<D>(sum / D);
  };
  double area = 0.0;
  Vec<D> low = mean(facets_[begin]), high = low;
  for (uint32_t i = begin; i < end; ++i) {
    const Vec<D> centre = mean(facets_[i]), vector = area_vector(facets_[i]);
    node.centre += vector.norm() * centre;
    node.dipole += vector;
    area += vector.norm();
    low = low.cwiseMin(centre);
    high = high.cwiseMax(centre);
  }
  node.centre = area > 0 ? Vec<D>(node.centre / area) : mean(facets_[begin]);
  for (uint32_t i = begin; i < end; ++i)
    for (const Vec<D>& corner : facets_[i]) node.radius = std::max(node.radius, (corner - node.centre).norm());

  const auto index = static_cast<uint32_t>(nodes_.size());
  nodes_.push_back(node);
  if (end - begin > kLeafFacets) {
    Eigen::Index axis = 0;
    (high - low).maxCoeff(&axis);
    const uint32_t middle = (begin + end) / 2;
    std::nth_element(facets_.begin() + begin, facets_.begin() + middle, facets_.begin() + end,
                     [&](const Facet& a, const Facet& b) { return mean(a)[axis] < mean(b)[axis]; });
    const uint32_t left = build(begin, middle), right = build(middle, end);
    nodes_[index].left = left;
    nodes_[index].right = right;
  }
  return index;
}

template <int D>
double WindingNumber<D>::evaluate(uint32_t index, const Vec<D>& x) const {
  const Node& node = nodes_[index];
  const Vec<D> to_centre = node.centre - x;
  if (to_centre.squaredNorm() > kFarRadii * kFarRadii * node.radius * node.radius)
    return dipole_field(to_centre, node.dipole);
  if (node.left != 0) return evaluate(node.left, x) + evaluate(node.right, x);
  return turned(facets_.data() + node.begin, facets_.data() + node.end, x);
}

template class WindingNumber<2>;
template class WindingNumber<3>;

}  // namespace barycast
