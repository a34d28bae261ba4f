#include "compute_arena.h"

#include <chrono>
#include <utility>

namespace barycast::server {

// No thread of ours ever joins the arena, so no slot is reserved for one: with a reserved slot that
// stays empty, a core would idle. oneTBB starts at most (allowed parallelism - 1) workers, one being
// left for a caller that we do not have; the limit is raised by that one, else it warns and gives less.
ComputeArena::ComputeArena(int threads)
    : threads_(threads),
      limit_(tbb::global_control::max_allowed_parallelism, static_cast<size_t>(threads) + 1),
      arena_(threads, 0) {
  arena_.initialize();
}

void ComputeArena::post(std::function<void()> task) {
  using Clock = std::chrono::steady_clock;
  arena_.enqueue([this, task = std::move(task), posted = Clock::now()] {
    waits_.observe(std::chrono::duration<double>(Clock::now() - posted).count());
    task();
  });
}

}  // namespace barycast::server
