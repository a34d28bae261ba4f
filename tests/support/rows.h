#pragma once

// Shorthands around the library's entry, and the promise on linear precision as a measurement.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "bind/binding.h"
#include "support/shapes.h"

namespace barycast::testing {

// With what samples of harmonic and mean value coordinates need.
inline std::shared_ptr<const CageIndex> make_index(const Shape& shape) {
  auto index = CageIndex::create(shape.input());
  EXPECT_TRUE(index.ok()) << (index.ok() ? "" : index.error().text());
  if (!index.ok()) return nullptr;
  for (const auto kind : {CoordinateKind::kHarmonic, CoordinateKind::kMeanValue})
    EXPECT_TRUE((*index)->prepare(*resolve({.coordinates = kind, .estimator = Estimator::kSampling}, false)).ok());
  return *index;
}

inline QueryInput loose_points(std::vector<double> points) {
  return {.points = std::move(points), .face_offsets = {}, .face_corners = {}};
}

// A query mesh from a shape's faces.
inline QueryInput mesh_of(const Shape& shape) {
  QueryInput queries{.points = shape.vertices, .face_offsets = {0}, .face_corners = {}};
  const auto add = [&](const std::vector<uint32_t>& corners, size_t per_face) {
    for (size_t i = 0; i < corners.size(); ++i) {
      queries.face_corners.push_back(corners[i]);
      if ((i + 1) % per_face == 0) queries.face_offsets.push_back(static_cast<uint32_t>(queries.face_corners.size()));
    }
  };
  add(shape.triangles, 3);
  add(shape.quads, 4);
  return queries;
}

inline RowBlock bind_or_die(const std::shared_ptr<const CageIndex>& index, const QueryInput& queries,
                            const Options& options, BindingSummary* summary = nullptr) {
  const auto resolved = resolve(options, !queries.face_offsets.empty());
  EXPECT_TRUE(resolved.ok()) << (resolved.ok() ? "" : resolved.error().text());
  if (!resolved.ok()) return {};
  auto block = bind_all(index, queries, *resolved, summary);
  EXPECT_TRUE(block.ok()) << (block.ok() ? "" : block.error().text());
  return block.ok() ? *block : RowBlock{};
}

// Row i, dense.
inline std::vector<double> dense_row(const RowBlock& block, size_t i, size_t control_vertices) {
  std::vector<double> row(control_vertices, 0.0);
  for (uint32_t e = block.offsets[i]; e < block.offsets[i + 1]; ++e) row[block.indices[e]] = block.values[e];
  return row;
}

// How far rows are from the promise of the numerics contract, in multiples of 1e-12: at most 1 is kept.
struct PromiseError {
  double sum = 0.0, position = 0.0, gradient = 0.0;
  double worst() const { return std::max({sum, position, gradient}); }
};

template <int D>
PromiseError promise_error(const CageIndex& index, const std::vector<double>& points, const RowBlock& block) {
  const Cage<D>& cage = std::get<std::unique_ptr<const CageStructures<D>>>(index.structures())->cage;
  using Long = Eigen::Matrix<long double, D, 1>;
  PromiseError error;
  for (size_t i = 0; i < block.row_count(); ++i) {
    const Vec<D> x = cage.frame().to_normalized(Eigen::Map<const Vec<D>>(points.data() + D * (block.first_row + i)));
    long double sum = -1;
    Long position = -x.template cast<long double>();
    Eigen::Matrix<long double, D, D + 1> jacobian = Eigen::Matrix<long double, D, D + 1>::Zero();
    for (int k = 0; k < D; ++k) jacobian(k, k) = -1;
    long double gradients = 0;
    for (uint32_t e = block.offsets[i]; e < block.offsets[i + 1]; ++e) {
      const Long vertex = cage.control_vertices()[block.indices[e]].template cast<long double>();
      sum += block.values[e];
      position += static_cast<long double>(block.values[e]) * vertex;
      if (block.gradients.empty()) continue;
      const Long gradient = (Eigen::Map<const Vec<D>>(block.gradients.data() + D * e) * cage.frame().diagonal)
                                .template cast<long double>();
      jacobian.template leftCols<D>() += gradient * vertex.transpose();
      jacobian.col(D) += gradient;
      gradients += gradient.norm();
    }
    const double reach = std::max(1.0, x.norm());
    error.sum = std::max(error.sum, std::abs(static_cast<double>(sum)) / (1e-12 * reach));
    error.position = std::max(error.position, static_cast<double>(position.norm()) / (1e-12 * reach));
    if (!block.gradients.empty())
      error.gradient =
          std::max(error.gradient, static_cast<double>(jacobian.norm() / std::max<long double>(1, gradients)) / 1e-12);
  }
  return error;
}

// Reproducible points in [low, high]^d.
inline std::vector<double> random_points(size_t count, int dimension, double low, double high, uint32_t seed) {
  std::mt19937_64 generator(seed);
  std::uniform_real_distribution<double> uniform(low, high);
  std::vector<double> points(count * static_cast<size_t>(dimension));
  for (double& value : points) value = uniform(generator);
  return points;
}

}  // namespace barycast::testing
