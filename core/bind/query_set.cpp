#include "bind/query_set.h"

#include <bit>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "base/cancel.h"
#include "base/parallel.h"
#include "base/random.h"
#include "base/tolerances.h"

namespace barycast {
namespace {

Error cancelled() {
  return {ErrorCode::kCancelled, "", "the request was cancelled"};
}

std::string item(const char* list, size_t index) {
  return std::string(list) + "[" + std::to_string(index) + "]";
}

template <int D>
Result<std::vector<Vec<D>>> read_points(std::span<const double> coordinates, const Frame<D>& frame,
                                        const std::atomic<bool>& cancel) {
  if (coordinates.empty()) return invalid_argument("points", "there are none; send at least one query point");
  if (coordinates.size() % D != 0)
    return invalid_argument("points", "the number of coordinates must be a multiple of " + std::to_string(D));
  std::vector<Vec<D>> points(coordinates.size() / D);
  for (size_t i = 0; i < points.size(); ++i) {
    if (is_cancelled(i, cancel)) return cancelled();
    Vec<D> x;
    for (int k = 0; k < D; ++k) x[k] = coordinates[i * D + static_cast<size_t>(k)];
    if (!x.allFinite()) return invalid_argument(item("points", i), "has a coordinate that is not finite");
    // -0 becomes +0: the two are one position.
    points[i] = frame.to_normalized(x).array() + 0.0;
    if (!(points[i].norm() < kQueryReachMax))
      return invalid_argument(item("points", i), "lies more than 1e9 cage diagonals away; are the units right?");
  }
  return points;
}

Status check_faces(const QueryInput& input, size_t point_count, const std::atomic<bool>& cancel) {
  const auto& offsets = input.face_offsets;
  if (offsets.empty())
    return input.face_corners.empty() ? Status(Done{})
                                      : Status(invalid_argument("faces", "there are corners, but no faces"));
  if (offsets.front() != 0 || offsets.back() != input.face_corners.size())
    return invalid_argument("faces", "the corner counts do not add up to the number of corners");
  for (size_t f = 0; f + 1 < offsets.size(); ++f) {
    if (is_cancelled(f, cancel)) return cancelled();
    if (offsets[f + 1] < offsets[f] || offsets[f + 1] - offsets[f] < 3 || offsets[f + 1] > input.face_corners.size())
      return invalid_argument(item("faces", f), "has fewer than 3 corners");
    for (uint32_t c = offsets[f]; c < offsets[f + 1]; ++c)
      if (input.face_corners[c] >= point_count)
        return invalid_argument(
            item("faces", f) + ".corner[" + std::to_string(c - offsets[f]) + "]",
            "index " + std::to_string(input.face_corners[c]) + " >= " + std::to_string(point_count) + " query points");
  }
  return Done{};
}

// Distinct positions in order of first appearance, found by their names in a table that is at most half full. False:
// `cancel` was seen set.
template <int D>
bool find_nodes(QuerySet<D>& set, const std::atomic<bool>& cancel) {
  const size_t count = set.points.size();
  std::vector<uint64_t> names(count);
  parallel_for(count, 1024, [&](size_t begin, size_t end) {
    for (size_t i = begin; i < end && !cancel; ++i) names[i] = position_key<D>(set.points[i]);
  });
  constexpr auto kFree = std::numeric_limits<uint32_t>::max();
  std::vector<uint32_t> first_point(std::bit_ceil(2 * count), kFree);
  set.node_of_point.resize(count);
  for (size_t i = 0; i < count; ++i) {
    if (is_cancelled(i, cancel)) return false;
    size_t slot = names[i] & (first_point.size() - 1);
    while (first_point[slot] != kFree && set.points[first_point[slot]] != set.points[i])
      slot = (slot + 1) & (first_point.size() - 1);
    if (first_point[slot] == kFree) {
      first_point[slot] = static_cast<uint32_t>(i);
      set.node_of_point[i] = static_cast<uint32_t>(set.nodes.size());
      set.nodes.push_back(set.points[i]);
    } else {
      set.node_of_point[i] = set.node_of_point[first_point[slot]];
    }
  }
  return true;
}

}  // namespace

template <int D>
Result<QuerySet<D>> QuerySet<D>::create(const QueryInput& input, const Frame<D>& frame,
                                        const std::atomic<bool>& cancel) {
  auto points = read_points<D>(input.points, frame, cancel);
  if (!points) return points.error();
  QuerySet set;
  set.points = std::move(points).value();
  if (auto status = check_faces(input, set.points.size(), cancel); !status) return status.error();

  if (!find_nodes(set, cancel)) return cancelled();
  if (const size_t repeated = set.points.size() - set.nodes.size(); repeated > 0)
    set.warnings.push_back(
        {"points", std::to_string(repeated) + " query points coincide with others and get the same rows"});

  if (input.face_offsets.empty()) return set;
  for (const Vec<D>& x : set.nodes) {
    set.mesh.nodes.push_back(Vec<3>::Zero());
    set.mesh.nodes.back().template head<D>() = x;
  }
  set.mesh.face_offsets = input.face_offsets;
  for (const uint32_t corner : input.face_corners) set.mesh.face_nodes.push_back(set.node_of_point[corner]);
  return set;
}

bool all_inside(const WindingNumber<3>& winding, std::span<const Vec<3>> points, const std::atomic<bool>& cancel) {
  std::atomic<bool> all = true;
  parallel_for(points.size(), 256, [&](size_t begin, size_t end) {
    for (size_t i = begin; i < end && all && !cancel; ++i)
      if (!winding.inside(points[i])) all = false;
  });
  return all;
}

template struct QuerySet<2>;
template struct QuerySet<3>;

}  // namespace barycast
