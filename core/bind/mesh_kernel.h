#pragma once

// The heat kernel of a query mesh, from the cache or factored anew, with what a summary says of it.

#include <atomic>
#include <span>
#include <vector>

#include "base/warning.h"
#include "smooth/kernel_cache.h"

namespace barycast {

// times: of every node, in squared diagonals. cache: null for none. Null: `cancel` was seen set.
KernelCache::Kernel find_mesh_kernel(const QueryMesh& mesh, std::span<const double> times, KernelCache* cache,
                                     const std::atomic<bool>& cancel, std::vector<Warning>& warnings);

}  // namespace barycast
