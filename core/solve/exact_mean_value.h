#pragma once

// Mean value coordinates of closed triangle cages in closed form [Ju et al. 2005; SBC 5.2]: no samples, no noise. For
// cages of triangles (and polygons, which are triangles about a mean point) that are closed and face one way.
//
// Cost: time and memory grow with the edges. 92 triangles take 1.5 to 2 us per point on one core of a shared server
// processor at 2 GHz, twice that with gradients, four points being worked on at a time; about four times that beyond
// kExactFar.
// Accuracy, measured against quadrature: values to 1e-12 within a diagonal of the centre, however close to the cage or
// to the plane of a face, and to 1e-10 at kExactFar; beyond, relative to the row, 1e-12 at 100 diagonals and growing
// with the distance (1e-11 at 1e4). Position is reproduced to 3e-13 max(1, |x|) up to 100 diagonals. Gradients
// likewise, but for 1e-16 over the distance from the cage where that is more. On the cage (kExactOnCage) the row is the
// basis, and its gradient that of a place kExactGradientShift inside: mean value coordinates are differentiable across
// faces; at edges and vertices it is one of the one-sided gradients.

#include <memory>

#include "base/result.h"
#include "solve/mean_value_weights.h"
#include "solve/solution.h"

namespace barycast {

// A millisecond a point.
inline constexpr size_t kExactTrianglesMax = 20'000;

class ExactMeanValue final : public Solution<3> {
 public:
  // The cage must outlive the result.
  // Errors: kInvalidArgument for estimator, where the cage has quads, too many triangles, or is not closed.
  static Result<std::unique_ptr<const ExactMeanValue>> create(const Cage<3>& cage);

  // Whether `create` would succeed. Errors: the same.
  static Status check(const Cage<3>& cage);

  void evaluate(std::span<const Vec<3>> points, bool gradients, SolvedRows<3>& out) const override;
  size_t bytes() const override;

 private:
  explicit ExactMeanValue(const Cage<3>& cage) : cage_(cage), mesh_(cage) {}

  struct Location {
    const Element* element;
    std::array<double, 4> shares;
  };
  Location closest(const Vec<3>& x) const;
  void write_row(size_t lane, size_t row, const MeanValueSums& sums, SolvedRows<3>& out) const;
  void write_on_cage(const Vec<3>& x, size_t row, MeanValueSums& sums, SolvedRows<3>& out) const;

  const Cage<3>& cage_;
  MeanValueMesh mesh_;
};

}  // namespace barycast
