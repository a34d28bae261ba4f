#pragma once

// One tiny computation for every kind of coordinates, run on the arena before the server says that it is
// ready: a tetrahedron, on which every kind is affine and so known exactly. Milliseconds. It catches a build
// or a machine that computes wrongly. Errors: kInternal, with the kind in the message.

#include "base/result.h"

namespace barycast::server {

Status self_test();

}  // namespace barycast::server
