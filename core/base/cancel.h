#pragma once

// A look at a cancel flag every few thousand items of a loop: some milliseconds of light work.

#include <atomic>
#include <cstddef>

namespace barycast {

inline bool is_cancelled(size_t i, const std::atomic<bool>& cancel) {
  return i % 4096 == 0 && cancel.load(std::memory_order_relaxed);
}

}  // namespace barycast
