#pragma once

// The kinds of coordinates that this build computes: GetCapabilities lists them, and the self-test tries each.
// Pure functions.

#include <vector>

#include "bind/options.h"

namespace barycast::server {

std::vector<CoordinateKind> built_kinds();
// "harmonic", "mean value", "positive mean value".
const char* kind_name(CoordinateKind kind);

}  // namespace barycast::server
