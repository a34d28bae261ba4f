#include "base/parallel.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/partitioner.h>
#include <tbb/task_arena.h>

namespace barycast {

void parallel_for(size_t count, size_t grain, const std::function<void(size_t, size_t)>& body) {
  tbb::parallel_for(
      tbb::blocked_range<size_t>(0, count, grain),
      [&](const tbb::blocked_range<size_t>& range) { body(range.begin(), range.end()); }, tbb::simple_partitioner());
}

void parallel_build(size_t count, size_t grain, const std::function<void(size_t, size_t)>& body) {
  tbb::this_task_arena::isolate([&] { parallel_for(count, grain, body); });
}

size_t parallel_width() {
  return static_cast<size_t>(tbb::this_task_arena::max_concurrency());
}

}  // namespace barycast
