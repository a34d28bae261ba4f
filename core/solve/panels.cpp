#include "solve/panels.h"

#include <algorithm>
#include <cmath>
#include <queue>
#include <string>

#include "query/element_distance.h"

namespace barycast {
namespace {

// Densities grow like a power of the distance to an edge, at worst -1/3 between faces at right angles. Panels that
// shrink like the square of their number towards the edge keep the error's order.
double graded(double t) {
  return t * t / (t * t + (1 - t) * (1 - t));
}

// In squared diagonals: below what rounding leaves of the area of a triangle whose corners lie on a line.
constexpr double kPanelAreaMin = 1e-15;

// How an element is cut: a triangle into rows[0] ^ 2 panels, a quad into rows[0] x rows[1] cells of four.
struct Cuts {
  bool is_quad;
  double area;
  std::array<double, 2> side;  // of a quad
  std::array<int, 2> rows = {1, 1};

  uint32_t panels() const { return static_cast<uint32_t>(is_quad ? 4 * rows[0] * rows[1] : rows[0] * rows[0]); }
  double panel_area() const { return area / panels(); }
  // The next finer cut: cells stay as square as they can.
  Cuts finer() const {
    Cuts result = *this;
    ++result.rows[is_quad && side[1] / rows[1] > side[0] / rows[0] ? 1 : 0];
    return result;
  }
};

Vec<3> position(const Cage<3>& cage, const Element& element, const Vec<2>& at) {
  if (element.kind == ElementKind::kQuad) return patch_of(cage, element).at(at[0], at[1]);
  return (1 - at[0] - at[1]) * cage.corner(element, 0) + at[0] * cage.corner(element, 1) +
         at[1] * cage.corner(element, 2);
}

double triangle_area(const Vec<3>& a, const Vec<3>& b, const Vec<3>& c) {
  return 0.5 * (b - a).cross(c - a).norm();
}

Cuts coarsest(const Cage<3>& cage, const Element& element) {
  const auto corner = [&](int i) -> const Vec<3>& { return cage.corner(element, i); };
  const auto side = [&](int i, int j) { return (corner(i) - corner(j)).norm(); };
  const double half = triangle_area(corner(0), corner(1), corner(2));
  if (element.kind == ElementKind::kTriangle) return {.is_quad = false, .area = half, .side = {}};
  return {.is_quad = true,
          .area = half + triangle_area(corner(0), corner(2), corner(3)),
          .side = {0.5 * (side(0, 1) + side(3, 2)), 0.5 * (side(0, 3) + side(1, 2))}};
}

// Cuts the element with the largest panels finer and finer, until the next step would exceed `count`.
std::vector<Cuts> choose_cuts(const Cage<3>& cage, uint32_t count) {
  std::vector<Cuts> cuts;
  uint32_t used = 0;
  for (const Element& element : cage.elements()) {
    cuts.push_back(coarsest(cage, element));
    used += cuts.back().panels();
  }
  // Among equals the first element.
  const auto later = [&](size_t a, size_t b) {
    const double first = cuts[a].panel_area(), second = cuts[b].panel_area();
    return first < second || (first == second && a > b);
  };
  std::priority_queue<size_t, std::vector<size_t>, decltype(later)> queue(later);
  for (size_t e = 0; e < cuts.size(); ++e) queue.push(e);
  while (true) {
    const size_t largest = queue.top();
    const Cuts finer = cuts[largest].finer();
    used += finer.panels() - cuts[largest].panels();
    if (used > count) return cuts;
    queue.pop();
    cuts[largest] = finer;
    queue.push(largest);
  }
}

// Appends a panel, unless corners in one place leave it without area.
void add_panel(const Cage<3>& cage, uint32_t element, const std::array<Vec<2>, 3>& parameter, std::vector<Panel>& out) {
  Panel panel;
  panel.element = element;
  panel.parameter = parameter;
  for (size_t k = 0; k < 3; ++k) panel.corner[k] = position(cage, cage.elements()[element], parameter[k]);
  panel.centre = (panel.corner[0] + panel.corner[1] + panel.corner[2]) / 3;
  const Vec<3> doubled = (panel.corner[1] - panel.corner[0]).cross(panel.corner[2] - panel.corner[0]);
  panel.area = 0.5 * doubled.norm();
  if (!(panel.area > kPanelAreaMin)) return;
  panel.normal = doubled.normalized();
  panel.radius = 0.0;
  for (size_t k = 0; k < 3; ++k) {
    panel.radius = std::max(panel.radius, (panel.corner[k] - panel.centre).norm());
    panel.point[k] = 0.5 * (panel.corner[k] + panel.centre);
    // The barycentric coordinate's gradient, twice.
    panel.gradient[k] = panel.normal.cross(panel.corner[(k + 2) % 3] - panel.corner[(k + 1) % 3]) / panel.area;
  }
  out.push_back(panel);
}

void cut_triangle(const Cage<3>& cage, uint32_t element, int n, std::vector<Panel>& out) {
  const auto at = [&](int i, int j) {
    const double a = graded(1 - double(i + j) / n), b = graded(double(i) / n), c = graded(double(j) / n);
    return Vec<2>(Vec<2>(b, c) / (a + b + c));
  };
  for (int i = 0; i < n; ++i)
    for (int j = 0; i + j < n; ++j) {
      add_panel(cage, element, {at(i, j), at(i + 1, j), at(i, j + 1)}, out);
      if (i + j + 2 <= n) add_panel(cage, element, {at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)}, out);
    }
}

// Four panels around the middle of a cell: on a twisted patch each of them lies on either side of the patch, and their
// mean on it. Two along a diagonal would all lie on one side: twice the error for as many panels (FireHydrant, 800
// panels: E 0.0016 instead of 0.0026).
void cut_quad(const Cage<3>& cage, uint32_t element, const std::array<int, 2>& rows, std::vector<Panel>& out) {
  const auto at = [&](int i, int j) { return Vec<2>(graded(double(i) / rows[0]), graded(double(j) / rows[1])); };
  for (int i = 0; i < rows[0]; ++i)
    for (int j = 0; j < rows[1]; ++j) {
      const std::array<Vec<2>, 4> corner = {at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)};
      const Vec<2> middle = 0.5 * (corner[0] + corner[2]);
      for (size_t k = 0; k < 4; ++k) add_panel(cage, element, {corner[k], corner[(k + 1) % 4], middle}, out);
    }
}

}  // namespace

const std::array<TrianglePoint, 7> kTriangleRule = [] {
  const double root = std::sqrt(15.0);
  std::array<TrianglePoint, 7> rule{TrianglePoint{{1 / 3.0, 1 / 3.0, 1 / 3.0}, 9 / 40.0}};
  for (size_t k = 0; k < 3; ++k)
    for (const double sign : {-1.0, 1.0}) {
      const double twice = (6 + sign * root) / 21, weight = (155 + sign * root) / 1200;
      TrianglePoint point{{twice, twice, twice}, weight};
      point.barycentric[k] = 1 - 2 * twice;
      rule[sign < 0 ? 1 + k : 4 + k] = point;
    }
  return rule;
}();

Status Panels::check(const Cage<3>& cage, uint32_t count) {
  uint64_t least = 0;
  for (const Element& element : cage.elements()) least += coarsest(cage, element).panels();
  if (least <= count) return Done{};
  return invalid_argument("panels", "this cage needs at least " + std::to_string(least) +
                                        " boundary elements, more than " + std::to_string(count));
}

Result<Panels> Panels::cut(const Cage<3>& cage, uint32_t count) {
  if (Status fits = check(cage, count); !fits) return fits.error();
  const std::vector<Cuts> cuts = choose_cuts(cage, count);
  Panels result;
  std::vector<double> weights(cage.node_count(), 0.0);
  result.node_size.assign(cage.node_count(), 0.0);
  for (uint32_t e = 0; e < cage.elements().size(); ++e) {
    const Element& element = cage.elements()[e];
    if (cuts[e].is_quad) cut_quad(cage, e, cuts[e].rows, result.panels);
    if (!cuts[e].is_quad) cut_triangle(cage, e, cuts[e].rows[0], result.panels);
    for (size_t i = 0; i < static_cast<size_t>(element.corner_count()); ++i) {
      result.node_size[element.node[i]] += std::sqrt(2 * cuts[e].panel_area());
      weights[element.node[i]] += 1.0;
    }
  }
  for (size_t node = 0; node < weights.size(); ++node)
    if (weights[node] > 0.0) result.node_size[node] /= weights[node];
  return result;
}

Vec<3> point_at(const Cage<3>& cage, const Element& element, const std::array<double, 4>& shares) {
  Vec<3> point = Vec<3>::Zero();
  for (int i = 0; i < element.corner_count(); ++i) point += shares[static_cast<size_t>(i)] * cage.corner(element, i);
  return point;
}

std::array<double, 4> element_shares(ElementKind kind, const Panel& panel, const std::array<double, 3>& barycentric) {
  Vec<2> at = Vec<2>::Zero();
  for (size_t k = 0; k < 3; ++k) at += barycentric[k] * panel.parameter[k];
  if (kind == ElementKind::kQuad)
    return {(1 - at[0]) * (1 - at[1]), at[0] * (1 - at[1]), at[0] * at[1], (1 - at[0]) * at[1]};
  return {1 - at[0] - at[1], at[0], at[1], 0.0};
}

}  // namespace barycast
