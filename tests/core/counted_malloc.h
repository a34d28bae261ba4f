#pragma once

// Counts what malloc hands out, for a program that links counted_malloc.cpp: the bytes of its chunks that
// are in use, and the most that ever were since the last reset. Exact, where the resident size is not.

#include <cstdint>

namespace barycast::testing {

uint64_t bytes_in_use();
uint64_t bytes_in_use_max();
// The maximum starts again at what is in use now.
void reset_bytes_in_use_max();

}  // namespace barycast::testing
