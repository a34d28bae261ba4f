#include "solve/cuts.h"

#include <algorithm>
#include <array>
#include <atomic>

#include "base/parallel.h"

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

bool passes_through(const Vec<3>& from, const Vec<3>& to, const FlatTriangle& triangle) {
  if ((from.cwiseMax(to).array() < triangle.low.array()).any() ||
      (from.cwiseMin(to).array() > triangle.high.array()).any())
    return false;
  const auto& c = triangle.corners;
  if (std::any_of(c.begin(), c.end(), [&](const Vec<3>& corner) { return corner == from || corner == to; }))
    return false;
  // Six times the volumes of tetrahedra: the ends are on two sides of the plane, the line on one of the three edges.
  const auto volume = [](const Vec<3>& a, const Vec<3>& b, const Vec<3>& d) { return a.cross(b).dot(d); };
  const Vec<3> side0 = c[1] - c[0], side1 = c[2] - c[0];
  if (volume(side0, side1, from - c[0]) * volume(side0, side1, to - c[0]) > 0) return false;
  const Vec<3> along = to - from, a = c[0] - from, b = c[1] - from, d = c[2] - from;
  const std::array sides = {volume(a, b, along), volume(b, d, along), volume(d, a, along)};
  const auto [least, most] = std::minmax_element(sides.begin(), sides.end());
  return (*least >= 0 || *most <= 0) && *least != *most;
}

}  // namespace

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
          mark(triangle.element);
          mark(static_cast<uint32_t>(e));
        }
      }
    }
  });
  return cut;
}

}  // namespace barycast
