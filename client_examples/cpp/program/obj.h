#pragma once

// Wavefront OBJ: vertices (`v`), faces of any size (`f`) and lines (`l`); everything else is skipped.
// Corners may be v, v/vt, v//vn or v/vt/vn, negative ones count back; a backslash at a line's end
// continues it; # starts a comment. Errors name file:line. Reads as the Python client does, so that both
// bind the same points to the same cage.

#include "model.h"

namespace barycast::program {

client::Result<Model> read_obj(const std::string& path);

}  // namespace barycast::program
