#pragma once

// The validated query points in the cage's normalized frame, and the mesh between their distinct
// positions. `QuerySet::create` is the only door. Linear in the input.

#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "base/result.h"
#include "base/warning.h"
#include "bind/binding.h"
#include "query/winding.h"
#include "smooth/laplacian.h"

namespace barycast {

template <int D>
struct QuerySet {
  // Errors, with paths: no points, a point that is not finite or too far, faces that name missing
  // points, offsets that do not fit; kCancelled.
  static Result<QuerySet> create(const QueryInput& input, const Frame<D>& frame, const std::atomic<bool>& cancel);

  std::vector<Vec<D>> points;
  // Points at equal positions are one node, so that seams of a mesh cannot crack under smoothing.
  std::vector<Vec<D>> nodes;
  std::vector<uint32_t> node_of_point;
  QueryMesh mesh;  // over the nodes
  std::vector<Warning> warnings;
};

// Whether a closed cage encloses all points. Ends early, with false, at a point that is not, or when cancelled.
bool all_inside(const WindingNumber<3>& winding, std::span<const Vec<3>> points, const std::atomic<bool>& cancel);

extern template struct QuerySet<2>;
extern template struct QuerySet<3>;

}  // namespace barycast
