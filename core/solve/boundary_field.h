#pragma once

// The solved boundary elements as a function of the query: potentials of the densities, inside with those of the
// values on the cage, corrected near the cage by what they miss on it, and projected where the cage does not enclose
// the query. See boundary_elements.h.

#include <memory>
#include <vector>

#include "query/distance_index.h"
#include "query/winding.h"
#include "solve/boundary_data.h"
#include "solve/density_groups.h"
#include "solve/double_layer.h"
#include "solve/panel_kernels.h"
#include "solve/solution.h"

namespace barycast {

// What was solved for.
struct BoundaryDensities {
  DensityGroups indirect;  // of all columns, for a single layer alone, on both sides; empty where nothing needs them
  DensityGroups inside;    // of the basis, beside the dipoles; empty where those would not do
};

// The same, with what it is evaluated with.
struct BoundaryParts {
  PanelKernels kernels;
  DoubleLayer dipoles;
  BoundaryData data;
  BoundaryDensities densities;
};

class BoundaryField final : public Solution<3> {
 public:
  BoundaryField(const Cage<3>& cage, const DistanceIndex<3>& distance, const WindingNumber<3>& winding,
                BoundaryParts parts);

  void evaluate(std::span<const Vec<3>> points, bool gradients, SolvedRows<3>& out) const override;
  size_t bytes() const override;

 private:
  static constexpr Eigen::Index kLanes = 8;  // columns summed together, half a group
  // A row per row of the kernels; `enclosed`: the same of 1 as dipoles, where there are dipoles.
  struct Potentials {
    DoubleLayer::Rows columns;
    Eigen::Array4d enclosed;
  };

  struct Query;
  void multiply(const PanelKernels::Tables& kernels, bool inside, Eigen::Index columns, Potentials& out) const;
  Query prepare(const Vec<3>& x, size_t row) const;
  Eigen::Index columns_of(const Query& query) const;
  void continue_beyond_panels(const Query& query, const Vec<3>& x, Eigen::Index row, bool gradient,
                              Potentials& out) const;
  BoundaryData::Row missing(const Query& query, const Potentials& at_y, Eigen::Index row) const;
  Vec<3> just_inside(const CagePoint<3>& y, double blend_width) const;
  void set_row(const BoundaryData::Row& values, SolvedRows<3>::Table& table, Eigen::Index row) const;
  void evaluate_with_gradient(const Query& query, SolvedRows<3>& out) const;
  void evaluate_values(std::span<const Query> queries, SolvedRows<3>& out) const;

  const Cage<3>& cage_;
  const DistanceIndex<3>& distance_;
  const WindingNumber<3>& winding_;
  PanelKernels kernels_;
  DoubleLayer dipoles_;
  BoundaryData data_;
  bool is_closed_;
  BoundaryDensities densities_;
};

}  // namespace barycast
