#include "estimate/locator.h"

#include <cmath>

#include "base/random.h"
#include "base/tolerances.h"
#include "query/element_distance.h"

namespace barycast {
namespace {

// Nearer than this part of the thickness, the direction from the cage to the query is rounding: with the
// default thickness 1e-6 diagonals, a few roundings of a query that was stored in float.
constexpr double kTie = 1e-3;

}  // namespace

// Where a query on the cage takes its samples from [SBC 4.5]: away from the cage, on the query's own
// side; on the inside where the query lies exactly on an element.
template <int D>
Vec<D> Locator<D>::shifted(const Vec<D>& x, const CagePoint<D>& closest) const {
  const double shift = kFrameShift * thickness_;
  if (closest.distance > kTie * thickness_) return closest.point + shift / closest.distance * (x - closest.point);
  // Against the normal as the cage faces on the whole, unless the other side is clearly further inside:
  // a hole whose border runs the way of the outline, a component that faces the other way.
  const Vec<D> normal = cage_.orientation() * element_normal(cage_, cage_.elements()[closest.element], closest.shares);
  const Vec<D> against = closest.point - shift * normal, along = closest.point + shift * normal;
  const bool other_side = std::abs(std::abs(winding_(along)) - 1) + 0.25 < std::abs(std::abs(winding_(against)) - 1);
  return other_side ? along : against;
}

template <int D>
SampleQuery<D> Locator<D>::locate(const Vec<D>& x, uint64_t seed, double within, bool known_inside,
                                  InsideTest<D>& inside, CagePoint<D>& closest, Located<D>& out) const {
  closest = distance_.closest(x, within);
  out.flags = 0;
  out.distance = closest.distance;
  out.on_cage.reset();
  const bool tie = closest.distance <= kTie * thickness_;
  if (!tie && !known_inside && !inside(x, closest.distance)) out.flags |= kRowOutside;
  SampleQuery<D> query{x, closest.distance, QueryRandom(seed, position_key<D>(x))};
  if (closest.distance < thickness_) {
    out.flags |= kRowOnCage;
    out.on_cage = closest;
    query.origin = shifted(x, closest);
    query.radius = distance_.closest(query.origin).distance;
  }
  return query;
}

template class Locator<2>;
template class Locator<3>;

}  // namespace barycast
