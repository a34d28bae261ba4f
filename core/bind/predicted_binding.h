#pragma once

// The binding by prediction and correction: walks find the corrections of all nodes, which are denoised (values alone:
// a column per control vertex, not gradients), and rows are predictions plus corrections.

#include <algorithm>
#include <memory>

#include "bind/binding.h"
#include "bind/query_set.h"

namespace barycast {

// Points whose walks a task advances together.
inline constexpr size_t kPredictedWalkTogether = 32;

// Points that a task makes rows of, together: predictions are cheapest where each cell of local expansions has many
// (solve/local_expansions.h); but rows should stay in the caches.
inline size_t predicted_rows_per_task(size_t control_vertices) {
  return std::clamp<size_t>(50'000 / std::max<size_t>(control_vertices, 1), 128, 512);
}

// The structures are prepared for the options. Errors: those of HarmonicPrediction::create; kCancelled.
Result<std::unique_ptr<Binding>> create_predicted_binding(std::shared_ptr<const CageIndex> index,
                                                          const CageStructures<3>& structures, QuerySet<3> queries,
                                                          const BindingSettings& settings,
                                                          const std::atomic<bool>& cancel);

}  // namespace barycast
