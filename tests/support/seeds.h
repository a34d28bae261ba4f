#pragma once

// Rows of some points as random variables: their means over seeds, and how far those are from what they would be over
// all seeds. Two ways to the same rows then agree, or do not, within what chance explains.

#include "support/rows.h"

namespace barycast::testing {

struct OverSeeds {
  std::vector<Eigen::VectorXd> mean;  // a row per point
  double noise = 0.0;                 // squared, of the means of all points together
};

// rows(seed, i): of a point.
template <class Rows>
OverSeeds over_seeds(size_t points, uint64_t seeds, const Rows& rows) {
  OverSeeds result;
  for (size_t i = 0; i < points; ++i) {
    std::vector<Eigen::VectorXd> own;
    for (uint64_t seed = 0; seed < seeds; ++seed) own.push_back(rows(seed, i));
    Eigen::VectorXd mean = Eigen::VectorXd::Zero(own[0].size());
    for (const Eigen::VectorXd& row : own) mean += row / double(seeds);
    for (const Eigen::VectorXd& row : own) result.noise += (row - mean).squaredNorm() / double(seeds * (seeds - 1));
    result.mean.push_back(std::move(mean));
  }
  return result;
}

inline Eigen::VectorXd row_vector(const RowBlock& block, size_t i, size_t control_vertices) {
  const std::vector<double> row = dense_row(block, i, control_vertices);
  return Eigen::Map<const Eigen::VectorXd>(row.data(), static_cast<Eigen::Index>(row.size()));
}

// Of a request, with its seed counted up.
inline OverSeeds over_seeds(const std::shared_ptr<const CageIndex>& index, const QueryInput& queries, Options options,
                            uint64_t seeds) {
  std::vector<RowBlock> blocks;
  for (uint64_t seed = 0; seed < seeds; ++seed, ++options.seed) blocks.push_back(bind_or_die(index, queries, options));
  return over_seeds(queries.points.size() / 3, seeds, [&](uint64_t seed, size_t i) {
    return row_vector(blocks[seed], i, index->control_vertex_count());
  });
}

inline double squared_difference(const std::vector<Eigen::VectorXd>& a, const std::vector<Eigen::VectorXd>& b) {
  double sum = 0.0;
  for (size_t i = 0; i < a.size(); ++i) sum += (a[i] - b[i]).squaredNorm();
  return sum;
}

// The trilinear coordinates of the box [-1, 1]^3, by the numbers of its vertices (support/shapes.h).
inline Eigen::VectorXd trilinear(const Vec<3>& x) {
  Eigen::VectorXd row(8);
  for (int v = 0; v < 8; ++v) {
    double value = 1.0;
    for (int k = 0; k < 3; ++k) value *= 0.5 * (1 + ((v >> (2 - k) & 1) != 0 ? x[k] : -x[k]));
    row[v] = value;
  }
  return row;
}

}  // namespace barycast::testing
