#pragma once

// What a binding would cost, before it exists: decided from sizes and options alone, so that a service can
// refuse before work starts. Pure functions.

#include <cstdint>

#include "bind/options.h"

namespace barycast {

// How large a binding would be. `stencil_max`: most control vertices behind one point of the cage, 4 unless
// it has larger polygons.
struct BindingSize {
  int dimension = 3;
  uint64_t control_vertices = 0;
  uint64_t stencil_max = 4;
  uint64_t points = 0;
  uint64_t face_corners = 0;
  uint64_t block_rows = 4096;
  uint64_t threads = 1;
};

// Working memory of a binding before it exists, meant as an upper bound for meshes that are surfaces.
uint64_t estimate_memory_bytes(const BindingSize& size, const ResolvedOptions& options);

}  // namespace barycast
