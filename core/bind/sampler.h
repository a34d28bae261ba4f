#pragma once

// The sampling strategy that options ask for.

#include "bind/cage_index.h"
#include "bind/options.h"
#include "estimate/point_estimator.h"

namespace barycast {

// Refers to the structures, which are prepared for the options.
template <int D>
Sampler<D> make_sampler(const ResolvedOptions& options, const CageStructures<D>& structures);

extern template Sampler<2> make_sampler(const ResolvedOptions&, const CageStructures<2>&);
extern template Sampler<3> make_sampler(const ResolvedOptions&, const CageStructures<3>&);

}  // namespace barycast
