#pragma once

#include <exception>
#include <new>

#include "base/result.h"

namespace barycast {

// What build() returns, a Result, or its exception as an error: for builds that others wait for, who must hear of the
// end whatever it is. Errors: kResourceExhausted without memory, else kInternal.
template <class Build>
auto guarded_build(const Build& build) -> decltype(build()) {
  try {
    return build();
  } catch (const std::bad_alloc&) {
    return Error{ErrorCode::kResourceExhausted, "cage", "out of memory while it was built; use a coarser cage"};
  } catch (const std::exception& e) {
    return Error{ErrorCode::kInternal, "cage", e.what()};
  }
}

}  // namespace barycast
