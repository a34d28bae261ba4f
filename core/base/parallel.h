#pragma once

// A parallel loop on the calling thread's task arena. Every index is handled by exactly one task, and
// tasks write to their own place only, so the number of threads cannot change a result.

#include <cstddef>
#include <functional>

namespace barycast {

// Calls body(begin, end) for pieces of [0, count) of at most `grain` indices each. Returns when all
// are done. The body must not throw.
void parallel_for(size_t count, size_t grain, const std::function<void(size_t begin, size_t end)>& body);

// The same for a build that other tasks may wait for: until it returns the calling thread takes up no other task, which
// might be one of those. What a body throws, such as std::bad_alloc, is thrown here; pieces not yet begun are left out.
void parallel_build(size_t count, size_t grain, const std::function<void(size_t begin, size_t end)>& body);

// Number of threads the calling arena may use.
size_t parallel_width();

}  // namespace barycast
