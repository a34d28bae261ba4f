#pragma once

// The solved boundary elements as a function of the query: potentials of the densities, corrected near the cage by
// what they miss on it, and projected where the cage does not enclose the query. See boundary_elements.h.

#include <memory>
#include <vector>

#include "query/distance_index.h"
#include "query/winding.h"
#include "solve/boundary_data.h"
#include "solve/panels.h"
#include "solve/solution.h"
#include "solve/tiled_cholesky.h"

namespace barycast {

class BoundaryField final : public Solution<3> {
 public:
  // `densities`: rows are the points of the panels, three each; groups of columns in the order of `data`.
  BoundaryField(const Cage<3>& cage, const DistanceIndex<3>& distance, const WindingNumber<3>& winding, Panels panels,
                const BoundaryData& data, const std::vector<TiledCholesky::Columns>& densities);

  void evaluate(std::span<const Vec<3>> points, bool gradients, SolvedRows<3>& out) const override;
  size_t bytes() const override;

 private:
  static constexpr Eigen::Index kLanes = 8;  // columns summed together
  using Charges = Eigen::Matrix<double, Eigen::Dynamic, kLanes, Eigen::RowMajor>;
  // Kernels of four potentials, or of one and its gradient: a row each, an entry per point of the panels.
  using Kernels = Eigen::Matrix<double, 4, Eigen::Dynamic, Eigen::RowMajor>;
  using Potentials = Eigen::Matrix<double, 4, Eigen::Dynamic, Eigen::RowMajor>;

  struct Query;
  void fill_kernels(const Vec<3>& x, Eigen::Index row, bool gradient, Kernels& kernels) const;
  void multiply(const Kernels& kernels, Eigen::Index columns, Potentials& out) const;
  Query prepare(const Vec<3>& x) const;
  void evaluate_with_gradient(const Query& query, Eigen::Index row, SolvedRows<3>& out) const;
  void evaluate_values(std::span<const Query> queries, Eigen::Index first_row, SolvedRows<3>& out) const;

  const Cage<3>& cage_;
  const DistanceIndex<3>& distance_;
  const WindingNumber<3>& winding_;
  Panels panels_;
  BoundaryData data_;
  bool is_closed_;
  Eigen::Array<double, Eigen::Dynamic, 3> points_;  // of the panels
  Eigen::ArrayXd charge_;                           // a third of the panel's area
  std::vector<Charges> densities_;                  // blocks of columns
};

}  // namespace barycast
