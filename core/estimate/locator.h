#pragma once

// Where query points are with respect to the cage, and where their samples start from.

#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "estimate/row_flags.h"
#include "query/distance_index.h"
#include "query/winding.h"
#include "sample/sample.h"

namespace barycast {

template <int D>
struct Located {
  std::optional<CagePoint<D>> on_cage;  // y, for a query within the thickness of the cage
  double distance = 0.0;                // to the cage
  uint8_t flags = 0;                    // RowFlags: on the cage, outside
};

// Const and thread-safe.
template <int D>
class Locator {
 public:
  Locator(const Cage<D>& cage, const DistanceIndex<D>& distance, const WindingNumber<D>& winding, double thickness)
      : cage_(cage), distance_(distance), winding_(winding), thickness_(thickness) {}

  // One query and one place for every point (normalized frame). Faster for neighbours in space.
  template <class Places>
  void locate(std::span<const Vec<D>> points, uint64_t seed, std::vector<SampleQuery<D>>& queries,
              Places&& places) const {
    queries.clear();
    CagePoint<D> closest;
    double within = std::numeric_limits<double>::infinity();
    for (size_t i = 0; i < points.size(); ++i) {
      if (i > 0) within = (closest.point - points[i]).norm();
      queries.push_back(locate(points[i], seed, within, closest, places[i]));
    }
  }

  const WindingNumber<D>& winding() const { return winding_; }

 private:
  // within: what the distance is known not to exceed.
  SampleQuery<D> locate(const Vec<D>& x, uint64_t seed, double within, CagePoint<D>& closest, Located<D>& out) const;
  Vec<D> shifted(const Vec<D>& x, const CagePoint<D>& closest) const;

  const Cage<D>& cage_;
  const DistanceIndex<D>& distance_;
  const WindingNumber<D>& winding_;
  double thickness_;
};

extern template class Locator<2>;
extern template class Locator<3>;

}  // namespace barycast
