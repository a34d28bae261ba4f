#pragma once

// The one oneTBB arena: every computation of the server runs here and nowhere else, so that gRPC's
// threads only move bytes. Tasks start in the order in which they were posted; short tasks that post
// their own continuation therefore share the arena fairly. A task must not block.

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <functional>

#include "counters.h"

namespace barycast::server {

class ComputeArena {
 public:
  // `threads`: workers, 1 or more. None is started before there is work.
  explicit ComputeArena(int threads);

  // Runs `task` soon, on a worker; returns at once. The task must not throw.
  void post(std::function<void()> task);

  int threads() const { return threads_; }
  // From posted to started: what a request waits for its turns.
  const DurationHistogram& waits() const { return waits_; }

 private:
  const int threads_;
  tbb::global_control limit_;  // must exist before the arena asks for workers
  DurationHistogram waits_;
  tbb::task_arena arena_;
};

}  // namespace barycast::server
