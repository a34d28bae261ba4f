#include "estimate/noise.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "base/parallel.h"
#include "base/tolerances.h"

namespace barycast {
namespace {

constexpr size_t kProbesMax = 48;
// A probe costs as much as four points: a sixteenth of the work, a quarter at most where points are few.
constexpr size_t kPointsPerProbe = 64, kProbesLeast = 4;
constexpr uint64_t kRandomizations = 4;

size_t probe_count(size_t points) {
  return points < kPointsPerProbe ? 0 : std::clamp(points / kPointsPerProbe, kProbesLeast, kProbesMax);
}

// Some of the points, the same in whatever order they come.
template <int D>
std::vector<size_t> choose(std::span<const Vec<D>> points, size_t count) {
  if (count == 0) return {};
  std::vector<std::pair<uint64_t, size_t>> order(points.size());
  for (size_t i = 0; i < points.size(); ++i) order[i] = {position_key<D>(points[i]), i};
  std::nth_element(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(count - 1), order.end());
  std::vector<size_t> chosen;
  for (size_t i = 0; i < count; ++i) chosen.push_back(order[i].second);
  return chosen;
}

// sum over v of (a_v - b_v)^2, of lists ascending by vertex.
template <class List>
double squared_difference(const List& a, const List& b) {
  double sum = 0.0;
  auto i = a.begin(), j = b.begin();
  while (i != a.end() || j != b.end()) {
    double difference = 0.0;
    const bool of_a = j == b.end() || (i != a.end() && i->vertex <= j->vertex);
    const bool of_b = i == a.end() || (j != b.end() && j->vertex <= i->vertex);
    if (of_a) difference += (i++)->weight;
    if (of_b) difference -= (j++)->weight;
    sum += difference * difference;
  }
  return sum;
}

// Ascending by vertex, each once.
void sum_by_vertex(std::vector<VertexWeight>& list) {
  std::sort(list.begin(), list.end(), [](const VertexWeight& a, const VertexWeight& b) { return a.vertex < b.vertex; });
  size_t last = 0;
  for (size_t i = 1; i < list.size(); ++i) {
    if (list[i].vertex == list[last].vertex) {
      list[last].weight += list[i].weight;
    } else {
      list[++last] = list[i];
    }
  }
  if (!list.empty()) list.resize(last + 1);
}

// The values of fits at x.
template <int D>
void evaluate(const Projected<D>& projected, const Vec<D>& x, std::vector<VertexWeight>& values) {
  values.clear();
  for (const LinearFit<D>& fit : projected.fits) values.push_back({fit.vertex, fit.u.dot(homogeneous<D>(x))});
}

// The mean over samples of sum over v of (phi_v - Lambda_v)^2.
template <int D>
double squared_residual(const Cage<D>& cage, const std::vector<Sample<D>>& samples, const Projected<D>& projected) {
  double sum = 0.0, weights = 0.0;
  std::vector<VertexWeight> basis, fitted;
  for (const Sample<D>& sample : samples) {
    basis.clear();
    cage.append_basis(cage.elements()[sample.element], sample.shares, 1.0, basis);
    sum_by_vertex(basis);
    evaluate(projected, sample.point, fitted);
    sum += std::abs(sample.weight) * squared_difference(basis, fitted);
    weights += std::abs(sample.weight);
  }
  return sum / weights;
}

// Of one point, squared; nothing where it is on the cage or has few samples.
template <int D>
std::optional<double> squared_noise(const PointEstimator<D>& estimator, const Cage<D>& cage, const Vec<D>& x,
                                    typename PointEstimator<D>::Workspace& workspace, const std::atomic<bool>& cancel) {
  std::vector<std::vector<VertexWeight>> rows(kRandomizations);
  double residual = 0.0;
  PointEstimate<D> estimate;
  for (uint64_t r = 0; r < kRandomizations; ++r) {
    const std::span points(&x, 1);
    if (!estimator.randomized(r + 1).estimate(points, cancel, workspace, std::span(&estimate, 1))) return std::nullopt;
    if ((estimate.flags & (kRowOnCage | kRowFewSamples)) != 0) return std::nullopt;
    residual += squared_residual(cage, workspace.samples[0].samples, estimate.projected) / kRandomizations;
    evaluate(estimate.projected, x, rows[r]);
  }
  // Over all pairs: twice the variance.
  double difference = 0.0;
  for (size_t a = 0; a < kRandomizations; ++a)
    for (size_t b = 0; b < a; ++b) difference += squared_difference(rows[a], rows[b]);
  const double variance = difference / (kRandomizations * (kRandomizations - 1));
  if (!(residual > 0.0)) return std::nullopt;
  return variance / residual;
}

}  // namespace

template <int D>
std::optional<double> relative_noise(const PointEstimator<D>& estimator, const Cage<D>& cage,
                                     std::span<const Vec<D>> points, uint32_t samples,
                                     const std::atomic<bool>& cancel) {
  const size_t count = probe_count(points.size());
  const std::vector<size_t> probes = choose<D>(points, count);
  std::vector<std::optional<double>> found(count);
  parallel_for(count, 1, [&](size_t begin, size_t end) {
    typename PointEstimator<D>::Workspace workspace(cage);
    for (size_t i = begin; i < end; ++i)
      found[i] = squared_noise(estimator, cage, points[probes[i]], workspace, cancel);
  });
  if (cancel) return std::nullopt;
  std::vector<double> squared;
  for (const auto& one : found)
    if (one) squared.push_back(*one);
  if (squared.empty()) return 1.0 / std::sqrt(static_cast<double>(samples));
  const auto middle = squared.begin() + static_cast<std::ptrdiff_t>(squared.size() / 2);
  std::nth_element(squared.begin(), middle, squared.end());
  return std::sqrt(*middle);
}

template std::optional<double> relative_noise(const PointEstimator<2>&, const Cage<2>&, std::span<const Vec<2>>,
                                              uint32_t, const std::atomic<bool>&);
template std::optional<double> relative_noise(const PointEstimator<3>&, const Cage<3>&, std::span<const Vec<3>>,
                                              uint32_t, const std::atomic<bool>&);

}  // namespace barycast
