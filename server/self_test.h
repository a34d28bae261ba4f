#pragma once

// One tiny computation, run on the arena before the server says that it is ready: a tetrahedron, whose
// coordinates are known exactly. Milliseconds. It catches a build or a machine that computes wrongly.
// Errors: kInternal.

#include "base/result.h"

namespace barycast::server {

Status self_test();

}  // namespace barycast::server
