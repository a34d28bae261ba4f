#pragma once

// A deterministic rule for integrals over directions: Gauss-Legendre in the height times equally spaced angles around,
// every ring turned by another golden angle, so that no ring repeats where an edge of the cage lies. Exact for smooth
// functions of low degree; what limits it are the kinks and jumps of what is seen.

#include <cmath>
#include <numbers>
#include <vector>

#include "base/vector.h"

namespace barycast::testing {

struct GaussNode {
  double position, weight;  // on [-1, 1]; weights sum to two
};

// The roots of a Legendre polynomial, by Newton from Chebyshev's guess; to rounding for thousands of nodes.
inline std::vector<GaussNode> gauss_legendre(int count) {
  std::vector<GaussNode> nodes;
  for (int i = 0; i < count; ++i) {
    double x = -std::cos(std::numbers::pi * (i + 0.75) / (count + 0.5)), slope = 1.0;
    for (int step = 0; step < 8; ++step) {
      double last = 1.0, value = x;
      for (int k = 2; k <= count; ++k) {
        const double next = ((2 * k - 1) * x * value - (k - 1) * last) / k;
        last = value;
        value = next;
      }
      slope = count * (x * value - last) / (x * x - 1);
      x -= value / slope;
    }
    nodes.push_back({x, 2 / ((1 - x * x) * slope * slope)});
  }
  return nodes;
}

class DirectionRule {
 public:
  // About `directions` of them: twice as many around as rings.
  explicit DirectionRule(size_t directions)
      : rings_(
            gauss_legendre(static_cast<int>(std::lround(std::ceil(std::sqrt(static_cast<double>(directions) / 2)))))),
        around_(2 * rings_.size()) {
    const double golden = std::numbers::pi * (3 - std::sqrt(5.0));
    for (size_t ring = 0; ring < rings_.size(); ++ring)
      for (size_t k = 0; k < around_; ++k) {
        const double angle = golden * static_cast<double>(ring) +
                             2 * std::numbers::pi * (static_cast<double>(k) + 0.5) / static_cast<double>(around_);
        circle_.push_back({std::cos(angle), std::sin(angle)});
      }
  }

  // Calls body(direction, weight) for all directions within `depth` = 1 - cos(half angle) of an axis; weights sum to
  // the solid angle over pi. A depth of two is all of the sphere.
  template <class Body>
  void for_each(const Vec<3>& axis, double depth, const Body& body) const {
    const Vec<3> first = axis.unitOrthogonal(), second = axis.cross(first);
    for (size_t ring = 0; ring < rings_.size(); ++ring) {
      const double below = depth * (1 - rings_[ring].position) / 2;  // 1 - height
      const double radius = std::sqrt(below * (2 - below));
      const double weight = depth * rings_[ring].weight / static_cast<double>(around_);
      for (size_t k = 0; k < around_; ++k) {
        const auto& [cosine, sine] = circle_[ring * around_ + k];
        body(Vec<3>((1 - below) * axis + radius * (cosine * first + sine * second)), weight);
      }
    }
  }

  size_t size() const { return circle_.size(); }

 private:
  struct Angle {
    double cosine, sine;
  };
  std::vector<GaussNode> rings_;
  size_t around_;
  std::vector<Angle> circle_;  // ring by ring
};

}  // namespace barycast::testing
