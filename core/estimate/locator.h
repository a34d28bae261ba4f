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
  double distance = 0.0;                // to the cage, or a lower bound that was known
  uint8_t flags = 0;                    // RowFlags: on the cage, outside
};

// What is known of a point beforehand: that it is inside of the cage, and at least this far from it; 0: nothing. Where
// it is `enough`, that stands for the distance, and the point's samples, which nobody will take, have no random
// numbers.
struct Clearances {
  std::span<const double> of_point = {};  // none: of no point
  double enough = std::numeric_limits<double>::infinity();
};

// Const and thread-safe.
template <int D>
class Locator {
 public:
  // closed: whether the cage is known to bound a volume (solve/closed.h), which saves time.
  Locator(const Cage<D>& cage, const DistanceIndex<D>& distance, const WindingNumber<D>& winding, double thickness,
          bool closed = false)
      : cage_(cage), distance_(distance), winding_(winding), thickness_(thickness), closed_(closed) {}

  // One query and one place for every point (normalized frame). Faster for neighbours in space, and for points of
  // which something is known.
  template <class Places>
  void locate(std::span<const Vec<D>> points, uint64_t seed, std::vector<SampleQuery<D>>& queries, Places&& places,
              const Clearances& known = {}) const {
    queries.clear();
    CagePoint<D> closest;
    InsideTest<D> inside(winding_, closed_);
    bool any = false;
    for (size_t i = 0; i < points.size(); ++i) {
      const double clearance = known.of_point.empty() ? 0.0 : known.of_point[i];
      if (clearance >= known.enough) {
        static_cast<Located<D>&>(places[i]) = {.on_cage = {}, .distance = clearance, .flags = 0};
        queries.push_back({points[i], clearance, QueryRandom(seed, 0)});
        continue;
      }
      const double within = any ? (closest.point - points[i]).norm() : std::numeric_limits<double>::infinity();
      queries.push_back(locate(points[i], seed, within, clearance > 0, inside, closest, places[i]));
      any = true;
    }
  }

  const WindingNumber<D>& winding() const { return winding_; }

 private:
  // within: what the distance is known not to exceed; known_inside: to be.
  SampleQuery<D> locate(const Vec<D>& x, uint64_t seed, double within, bool known_inside, InsideTest<D>& inside,
                        CagePoint<D>& closest, Located<D>& out) const;
  Vec<D> shifted(const Vec<D>& x, const CagePoint<D>& closest) const;

  const Cage<D>& cage_;
  const DistanceIndex<D>& distance_;
  const WindingNumber<D>& winding_;
  double thickness_;
  bool closed_;
};

extern template class Locator<2>;
extern template class Locator<3>;

}  // namespace barycast
