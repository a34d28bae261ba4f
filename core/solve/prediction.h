#pragma once

// A prediction of harmonic coordinates to be corrected by walks: a small boundary-element solution, evaluated in
// floats, inside of closed cages by local expansions, and what it misses on the cage. Whatever its error, it is
// harmonic, so that
//
//   alpha_v(x) = h_v(x) + E[phi_v(y) - h_v(y)],   y: where a walk from x ends
//
// holds exactly (control variate): walks have to find the mean of what it misses, a small fraction of the coordinates.
// Inside closed cages the columns are the control vertices that the elements use; elsewhere the moments of
// solve/boundary_data.h, from which the projection makes coordinates.
//
// Not corrected is what straight lines between the nodes of the table of what is missing leave out: less than .001 of
// coordinates, for on elements that cut each other it is evaluated where it bends more. Nor is what expansions leave
// out, some 2e-5 of a row. Seen from outside, of closed
// cages thinner than half a hundredth of their diagonal, panels wider than the walls are apart do not cancel: there few
// walks do not correct it (estimate/corrected_estimator.h). Outside, panels of a twisted quad may lie on the other
// side of a point next to it: there slopes are those of that side.
//
// Depends on the cage alone. Const and thread-safe; deterministic.

#include <atomic>
#include <memory>
#include <optional>

#include "base/result.h"
#include "query/winding.h"
#include "solve/boundary_elements.h"
#include "solve/local_expansions.h"
#include "solve/panel_sums.h"
#include "solve/residual_table.h"

namespace barycast {

class HarmonicPrediction {
 public:
  // For the inside of a closed cage or for elsewhere. Solves, on the threads of the calling arena. The cage and its
  // index must outlive what comes of it. Errors: those of BoundarySolver::create.
  static Result<std::unique_ptr<const HarmonicPrediction>> create(const Cage<3>& cage, const DistanceIndex<3>& distance,
                                                                  BoundarySides side);
  // From what was solved for: of this cage, or anything else that is harmonic off it. Only noise depends on that.
  static std::unique_ptr<const HarmonicPrediction> of(const Cage<3>& cage, const DistanceIndex<3>& distance,
                                                      BoundaryParts parts);
  // Whether a cage is one that a prediction pays for: beyond these sizes solving takes more than half a second, and the
  // table of what is missing too much memory. Errors: kInvalidArgument ("estimator").
  static constexpr uint64_t kTrianglesMost = 500, kVerticesMost = 300;
  static Status check(uint64_t surface_triangles, uint64_t control_vertices);

  const BoundaryData& data() const { return parts_.data; }
  Eigen::Index columns() const { return data().count(); }

  using Rows = PanelSums::Rows;
  // h at points of the side, a row each; with gradients per diagonal if asked for. A point's row depends on that point
  // alone, bit for bit. False: `cancel` was seen set.
  bool evaluate(std::span<const Vec<3>> points, bool gradients, const std::atomic<bool>& cancel, Rows& out) const;

  // Adds weight times what the prediction misses at a point of the cage to columns() sums, from a table.
  void add_missing(uint32_t element, const std::array<double, 4>& shares, double weight, std::span<double> sum) const {
    missing_.add(element, shares, weight, sum);
  }
  // Where the table says too little of it; and the same, evaluated, a row for each point of the cage. On the border of
  // an element that is what it is a little inside of it, for one side of the cage only.
  bool has_rough() const { return missing_.has_rough(); }
  bool is_rough(uint32_t element, const std::array<double, 4>& shares) const {
    return missing_.is_rough(element, shares);
  }
  void evaluate_missing(std::span<const ResidualTable::Node> points, Rows::Table& missing) const;

  size_t bytes() const;

  // The same for a cage that passes the check, from its size, as an estimate: what is kept, and the peak while it is
  // made. A larger one counts as the largest that does. triangles: quads are two each.
  struct CageSize {
    size_t elements, triangles, control_vertices;
  };
  static size_t bytes(const CageSize& cage, BoundarySides side);
  static size_t solving_bytes(const CageSize& cage, BoundarySides side);

 private:
  HarmonicPrediction(const Cage<3>& cage, const DistanceIndex<3>& distance, BoundaryParts parts);
  bool has_dipoles() const { return !parts_.densities.inside.empty(); }
  void find_missing();
  void continue_beyond_panels(const CagePoint<3>& y, const Vec<3>& x, size_t row, bool gradients, Rows& rows) const;

  const Cage<3>& cage_;
  const DistanceIndex<3>& distance_;
  BoundaryParts parts_;
  PanelSums sums_;
  std::optional<LocalExpansions> expansions_;  // with dipoles, where they hold
  ResidualTable missing_;
};

}  // namespace barycast
