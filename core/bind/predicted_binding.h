#pragma once

// The binding by prediction and correction: walks find the corrections of all nodes, which are denoised (values alone:
// a column per control vertex, not gradients), and rows are predictions plus corrections.

#include <memory>

#include "bind/binding.h"
#include "bind/query_set.h"

namespace barycast {

// The structures are prepared for the options. Errors: those of HarmonicPrediction::create; kCancelled.
Result<std::unique_ptr<Binding>> create_predicted_binding(std::shared_ptr<const CageIndex> index,
                                                          const CageStructures<3>& structures, QuerySet<3> queries,
                                                          const BindingSettings& settings,
                                                          const std::atomic<bool>& cancel);

}  // namespace barycast
