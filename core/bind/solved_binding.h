#pragma once

// Bindings without samples: the estimators of `solve`, behind the same pulled interface.

#include <memory>

#include "bind/binding.h"
#include "bind/query_set.h"

namespace barycast {

// The cage suits the estimator (check_estimator). Errors: kCancelled, and those of the estimators.
Result<std::unique_ptr<Binding>> create_solved_binding(std::shared_ptr<const CageIndex> index,
                                                       const CageStructures<3>& structures, QuerySet<3> queries,
                                                       const BindingSettings& settings,
                                                       const std::atomic<bool>& cancel);

}  // namespace barycast
