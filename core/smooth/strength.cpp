#include "smooth/strength.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "base/cancel.h"

namespace barycast {
namespace {

// Times the median squared edge. The best times of four models, two kinds and 20 to 200 samples, a noise from 0.004 to
// 0.26: 11 to 22 times the noise where coordinates bend as those of characters do, 47 to 75 in a box. Within a factor
// of two of the best the error hardly changes.
constexpr double kEdgesPerNoise = 28.0;
constexpr double kNoiseLarge = 0.5;
constexpr double kEdgesOfCorrections = 4.0;

// At 50 samples; within a factor of two they hardly matter.
constexpr double kSamplesReference = 50.0;
constexpr double kDistanceOfWalks = 0.2;  // times the squared distance of the cage
constexpr double kDistanceOfRays = 0.05;

// The best time goes with the power 2/3 of the error. Where it is shorter than a squared edge, as for more rays than
// these, the noise falls in proportion to it instead, and the best time goes with the square of the error: half way. At
// 1,000 rays denoising leaves 0.9 to 1.1 of the error inside; with the power 2/3 it made that 1.0 to 2.6.
double relative_time(ErrorRate rate, double samples) {
  const double fewer = kSamplesReference / samples;
  return rate == ErrorRate::kLinear ? std::pow(fewer, (fewer < 1.0 ? 4.0 : 2.0) / 3) : std::cbrt(fewer);
}

}  // namespace

std::optional<SquaredEdges> squared_edges(const QueryMesh& mesh, const std::atomic<bool>& cancel) {
  // Calls visit(lower, upper) for every side of every face; false when cancelled.
  const auto for_each_side = [&](const auto& visit) {
    for (size_t f = 0; f < mesh.face_count(); ++f) {
      if (is_cancelled(f, cancel)) return false;
      const auto face = mesh.face(f);
      for (size_t i = 0; i < face.size(); ++i) {
        const uint32_t a = face[i], b = face[(i + 1) % face.size()];
        if (a != b) visit(std::min(a, b), std::max(a, b));
      }
    }
    return true;
  };
  // Sides by their lower node; an edge is what is left of them once repetitions are dropped.
  std::vector<size_t> begin(mesh.nodes.size() + 2, 0);
  if (!for_each_side([&](uint32_t lower, uint32_t) { ++begin[lower + 2]; })) return std::nullopt;
  for (size_t i = 2; i < begin.size(); ++i) begin[i] += begin[i - 1];
  std::vector<uint32_t> upper_node(begin.back());
  if (!for_each_side([&](uint32_t lower, uint32_t upper) { upper_node[begin[lower + 1]++] = upper; }))
    return std::nullopt;
  std::vector<double> squared;
  for (size_t a = 0; a < mesh.nodes.size(); ++a) {
    if (is_cancelled(a, cancel)) return std::nullopt;
    const auto first = upper_node.begin() + static_cast<std::ptrdiff_t>(begin[a]);
    const auto last = upper_node.begin() + static_cast<std::ptrdiff_t>(begin[a + 1]);
    std::sort(first, last);
    const auto end = std::unique(first, last);
    for (auto b = first; b != end; ++b) squared.push_back((mesh.nodes[a] - mesh.nodes[*b]).squaredNorm());
  }
  if (squared.empty()) return SquaredEdges{};
  SquaredEdges result{.mean =
                          std::accumulate(squared.begin(), squared.end(), 0.0) / static_cast<double>(squared.size())};
  const auto middle = squared.begin() + static_cast<std::ptrdiff_t>(squared.size() / 2);
  std::nth_element(squared.begin(), middle, squared.end());
  result.median = *middle;
  return result;
}

double smoothing_time_as_printed(const SquaredEdges& edges, double samples) {
  return edges.mean * std::max(1.0, 5.0 - std::log10(samples));
}

double smoothing_time(const SquaredEdges& edges, double relative_noise) {
  return edges.median * kEdgesPerNoise * relative_noise / (1.0 + relative_noise / kNoiseLarge);
}

double smoothing_time_of_corrections(const SquaredEdges& edges) {
  return edges.median * kEdgesOfCorrections;
}

double smoothing_time_per_squared_distance(ErrorRate rate, double samples) {
  return (rate == ErrorRate::kLinear ? kDistanceOfRays : kDistanceOfWalks) * relative_time(rate, samples);
}

}  // namespace barycast
