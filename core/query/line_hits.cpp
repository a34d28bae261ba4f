#include "query/line_hits.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "query/meet_lanes.h"

namespace barycast {
namespace {

// On which side of the line a point is, and how far. Every call must give the same bits for the same point, wherever
// it is inlined: fma is spelt out.
double image(const Vec<2>& origin, const Vec<2>& direction, const Vec<2>& point) {
  const Vec<2> from_origin = point - origin;
  const double other = direction[1] * from_origin[0];
  return std::fma(direction[0], from_origin[1], -other);
}

// A line has few hits: up to so many are sorted by insertion.
constexpr size_t kFewHits = 16;

}  // namespace

template <>
int meet(const Vec<2>& origin, const Vec<2>& direction, const Cage<2>& cage, uint32_t index,
         std::array<LineHit<2>, 2>& hits) {
  const Element& element = cage.elements()[index];
  const Vec<2>&first = cage.corner(element, 0), &second = cage.corner(element, 1);
  const double a = image(origin, direction, first), b = image(origin, direction, second);
  if ((a > 0) == (b > 0)) return 0;
  const double of_first = b / (b - a), of_second = a / (a - b);
  const Vec<2> point = of_first * first + of_second * second;
  hits[0] = {direction.dot(point - origin), index, 0, {of_first, of_second, 0, 0}, point};
  return 1;
}

template <>
int meet(const Vec<3>& origin, const Vec<3>& direction, const Cage<3>& cage, uint32_t index,
         std::array<LineHit<3>, 2>& hits) {
  thread_local std::vector<LineHit<3>> found;
  found.clear();
  const ElementCorners corners = corners_of(cage, cage.elements()[index]);
  const LineCandidate candidate{0, 0};
  meet_candidates({&corners, 1}, cage.elements()[index].kind == ElementKind::kQuad, origin, {&direction, 1},
                  {&candidate, 1}, -std::numeric_limits<double>::infinity(), found);
  for (size_t i = 0; i < found.size(); ++i) {
    hits[i] = found[i];
    hits[i].element = index;
  }
  return static_cast<int>(found.size());
}

template <int D>
void order_hits(size_t lines, LineHits<D>& hits) {
  // By counting, which keeps the order of each line's.
  hits.end.assign(lines + 1, 0);
  for (const LineHit<D>& hit : hits.hits) ++hits.end[hit.line + 1];
  for (size_t i = 0; i < lines; ++i) hits.end[i + 1] += hits.end[i];
  hits.order.resize(hits.hits.size());
  // A line's begin moves to its end.
  for (uint32_t i = 0; i < hits.hits.size(); ++i) hits.order[hits.end[hits.hits[i].line]++] = i;
  hits.end.pop_back();
  const auto before = [&](uint32_t i, uint32_t j) {
    const LineHit<D>&a = hits.hits[i], &b = hits.hits[j];
    return a.t < b.t || (a.t == b.t && a.element < b.element);
  };
  size_t begin = 0;
  for (const size_t end : hits.end) {
    uint32_t* const order = hits.order.data();
    if (end - begin > kFewHits) {
      std::stable_sort(order + begin, order + end, before);
    } else {
      for (size_t next = begin + 1; next < end; ++next) {
        const uint32_t moved = order[next];
        size_t to = next;
        for (; to > begin && before(moved, order[to - 1]); --to) order[to] = order[to - 1];
        order[to] = moved;
      }
    }
    begin = end;
  }
}

template void order_hits(size_t, LineHits<2>&);
template void order_hits(size_t, LineHits<3>&);

}  // namespace barycast
