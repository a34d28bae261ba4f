#include "solve/cuts.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>

#include "base/parallel.h"
#include "base/tolerances.h"
#include "query/element_distance.h"

namespace barycast {
namespace {

struct FlatTriangle {
  uint32_t element;
  std::array<Vec<3>, 3> corners;
  Vec<3> low, high;
};

std::vector<FlatTriangle> flat_triangles(const Cage<3>& cage) {
  std::vector<FlatTriangle> result;
  for (uint32_t e = 0; e < cage.elements().size(); ++e) {
    const Element& element = cage.elements()[e];
    for (int second = 1; second + 1 < element.corner_count(); ++second) {
      const std::array corners = {cage.corner(element, 0), cage.corner(element, second),
                                  cage.corner(element, second + 1)};
      result.push_back({e, corners, corners[0].cwiseMin(corners[1]).cwiseMin(corners[2]),
                        corners[0].cwiseMax(corners[1]).cwiseMax(corners[2])});
    }
  }
  return result;
}

// Rounding alone makes corners of flat pieces of the cage stand out by 1e-16.
constexpr double kDepthMin = 0.1 * kThicknessDefault;

bool passes_through(const Vec<3>& from, const Vec<3>& to, const FlatTriangle& triangle) {
  if ((from.cwiseMax(to).array() < triangle.low.array()).any() ||
      (from.cwiseMin(to).array() > triangle.high.array()).any())
    return false;
  const auto& c = triangle.corners;
  const Vec<3> normal = (c[1] - c[0]).cross(c[2] - c[0]).normalized();
  const double above = normal.dot(from - c[0]), below = normal.dot(to - c[0]);
  if (!(std::min(above, below) < -kDepthMin && std::max(above, below) > kDepthMin)) return false;
  // Six times the volumes of tetrahedra: the line is on one side of all three edges.
  const auto volume = [](const Vec<3>& a, const Vec<3>& b, const Vec<3>& d) { return a.cross(b).dot(d); };
  const Vec<3> along = to - from, a = c[0] - from, b = c[1] - from, d = c[2] - from;
  const auto [least, most] = std::minmax({volume(a, b, along), volume(b, d, along), volume(d, a, along)});
  return (least >= 0 || most <= 0) && least != most;
}

// Of the gap to the longest edge. Nodes of a table are some twentieths of it apart.
constexpr double kGapPart = 0.125;

// Squared, of two segments.
double squared_distance(const Vec<3>& a, const Vec<3>& b, const Vec<3>& c, const Vec<3>& d) {
  double least =
      std::min({closest_on_segment<3>(a, c, d).distance_squared, closest_on_segment<3>(b, c, d).distance_squared,
                closest_on_segment<3>(c, a, b).distance_squared, closest_on_segment<3>(d, a, b).distance_squared});
  // Both ends inside: where a line is across both.
  const Vec<3> u = b - a, v = d - c, w = c - a, across = u.cross(v);
  const double squared = across.squaredNorm();
  if (squared <= 0.0) return least;
  const double s = w.cross(v).dot(across) / squared, t = w.cross(u).dot(across) / squared;
  if (s > 0 && s < 1 && t > 0 && t < 1) least = std::min(least, std::pow(w.dot(across), 2) / squared);
  return least;
}

// Squared, of two triangles that do not cut each other.
double squared_distance(const std::array<Vec<3>, 3>& a, const std::array<Vec<3>, 3>& b) {
  double least = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < 3; ++i) {
    least = std::min({least, closest_on_triangle(a[i], b[0], b[1], b[2]).distance_squared,
                      closest_on_triangle(b[i], a[0], a[1], a[2]).distance_squared});
    for (size_t k = 0; k < 3; ++k)
      least = std::min(least, squared_distance(a[i], a[(i + 1) % 3], b[k], b[(k + 1) % 3]));
  }
  return least;
}

bool within(const FlatTriangle& a, const FlatTriangle& b, double distance) {
  const Vec<3> apart = (a.low - b.high).cwiseMax(b.low - a.high).cwiseMax(0.0);
  return apart.squaredNorm() < distance * distance && squared_distance(a.corners, b.corners) < distance * distance;
}

bool has_corner(const Cage<3>& cage, const Element& element, const Vec<3>& x) {
  for (int i = 0; i < element.corner_count(); ++i)
    if (cage.corner(element, i) == x) return true;
  return false;
}

bool share_corner(const Cage<3>& cage, const Element& a, const Element& b) {
  for (int i = 0; i < a.corner_count(); ++i)
    if (has_corner(cage, b, cage.corner(a, i))) return true;
  return false;
}

double longest_edge(const Cage<3>& cage, const Element& element) {
  double longest = 0.0;
  for (int k = 0; k < element.corner_count(); ++k)
    longest =
        std::max(longest, (cage.corner(element, (k + 1) % element.corner_count()) - cage.corner(element, k)).norm());
  return longest;
}

}  // namespace

std::vector<uint8_t> close_elements(const Cage<3>& cage) {
  const std::vector<FlatTriangle> triangles = flat_triangles(cage);
  std::vector<uint8_t> close(cage.elements().size(), 0);
  parallel_for(triangles.size(), 8, [&](size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      const Element& element = cage.elements()[triangles[i].element];
      const double gap = std::min(kGapMost, kGapPart * longest_edge(cage, element));
      const auto is_close = [&](const FlatTriangle& other) {
        return other.element != triangles[i].element && within(triangles[i], other, gap) &&
               !share_corner(cage, element, cage.elements()[other.element]);
      };
      if (std::ranges::any_of(triangles, is_close))
        std::atomic_ref(close[triangles[i].element]).store(1, std::memory_order_relaxed);
    }
  });
  return close;
}

std::vector<uint8_t> cut_elements(const Cage<3>& cage) {
  const std::vector<FlatTriangle> triangles = flat_triangles(cage);
  std::vector<uint8_t> cut(cage.elements().size(), 0);
  const auto mark = [&](uint32_t element) { std::atomic_ref(cut[element]).store(1, std::memory_order_relaxed); };
  parallel_for(cage.elements().size(), 8, [&](size_t begin, size_t end) {
    for (size_t e = begin; e < end; ++e) {
      const Element& element = cage.elements()[e];
      for (int k = 0; k < element.corner_count(); ++k) {
        const Vec<3>&from = cage.corner(element, k), &to = cage.corner(element, (k + 1) % element.corner_count());
        for (const FlatTriangle& triangle : triangles) {
          if (triangle.element == e || !passes_through(from, to, triangle)) continue;
          const Element& other = cage.elements()[triangle.element];
          if (has_corner(cage, other, from) || has_corner(cage, other, to)) continue;
          mark(triangle.element);
          mark(static_cast<uint32_t>(e));
        }
      }
    }
  });
  // A box that dips into a face with its bottom is cut at its sides, next to the bottom.
  std::vector<bool> marked(cage.node_count(), false);
  for (size_t e = 0; e < cut.size(); ++e)
    for (int k = 0; cut[e] != 0 && k < cage.elements()[e].corner_count(); ++k)
      marked[cage.elements()[e].node[static_cast<size_t>(k)]] = true;
  for (size_t e = 0; e < cut.size(); ++e)
    for (int k = 0; k < cage.elements()[e].corner_count(); ++k)
      if (marked[cage.elements()[e].node[static_cast<size_t>(k)]]) cut[e] = 1;
  return cut;
}

}  // namespace barycast
