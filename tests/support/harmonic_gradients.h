#pragma once

// Gradients of harmonic coordinates inside a closed cage, for points near it, where those of boundary elements converge
// slowly: those of a prediction and of its correction, as the service has them, but with what the prediction misses
// evaluated where each of very many walks ends. What lies between the nodes of its table is then not left out.

#include <numeric>

#include "base/parallel.h"
#include "estimate/first_steps.h"
#include "query/distance_index.h"
#include "sample/walks.h"
#include "solve/prediction.h"
#include "support/dense_rows.h"

namespace barycast::testing {

// Sums of what is missing at the walks' ends, and their slopes.
inline std::vector<float> corrected_gradient(const HarmonicPrediction& prediction, const SampleQuery<3>& query,
                                             const SampleSet<3>& walks) {
  constexpr size_t kTogether = 256;
  const auto columns = static_cast<size_t>(prediction.columns());
  std::vector<Vec<3>> directions(walks.samples.size());
  first_directions(query.random, directions);
  FirstSteps steps;
  steps.start(directions, query.radius, columns);
  std::vector<double> sums(columns, 0.0), found(columns);
  std::vector<ResidualTable::Node> ends;
  HarmonicPrediction::Rows::Table missing;
  for (size_t first = 0; first < walks.samples.size(); first += kTogether) {
    ends.clear();
    for (size_t k = first; k < std::min(first + kTogether, walks.samples.size()); ++k)
      ends.push_back({walks.samples[k].element, walks.samples[k].shares});
    prediction.evaluate_missing(ends, missing);
    for (size_t k = 0; k < ends.size(); ++k) {
      for (size_t v = 0; v < columns; ++v)
        found[v] = double{missing(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(v))};
      steps.add(first + k, found);
      for (size_t v = 0; v < columns; ++v) sums[v] += found[v];
    }
  }
  std::vector<float> gradient(3 * columns);
  steps.finish(sums, gradient);
  return gradient;
}

// points x 3 control vertices: all partial derivatives by the first coordinate before those by the second, per unit of
// the caller's length. Points must be inside.
inline DenseRows harmonic_gradients(const Cage<3>& cage, std::span<const double> points, uint32_t walks) {
  const std::atomic<bool> never = false;
  const auto distance = make_distance_grid<3>(cage).value();
  const auto prediction = HarmonicPrediction::create(cage, *distance, BoundarySides::kInside).value();
  const HarmonicWalks<3> sampler(*distance, {.walks = walks, .thickness = 1e-4});
  const Eigen::Index n = cage.control_vertex_count();
  DenseRows rows = DenseRows::Zero(static_cast<Eigen::Index>(points.size() / 3), 3 * n);
  parallel_for(points.size() / 3, 1, [&](size_t begin, size_t end) {
    for (size_t i = begin; i < end; ++i) {
      const Vec<3> x = normalized_point(cage, points, i);
      const SampleQuery<3> query{x, distance->closest(x).distance, QueryRandom(7, position_key<3>(x))};
      SampleSet<3> set;
      sampler.sample({&query, 1}, never, {&set, 1});
      const std::vector<float> correction = corrected_gradient(*prediction, query, set);
      HarmonicPrediction::Rows predicted;
      prediction->evaluate({&x, 1}, true, never, predicted);
      size_t entry = 0;
      for (size_t a = 0; a < 3; ++a)
        for (Eigen::Index column = 0; column < prediction->columns(); ++column) {
          const auto v = static_cast<Eigen::Index>(cage.used_vertices()[static_cast<size_t>(column)]);
          rows(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(a) * n + v) =
              (double{predicted.gradients[a](0, column)} + double{correction[entry++]}) / cage.frame().diagonal;
        }
    }
  });
  return rows;
}

}  // namespace barycast::testing
