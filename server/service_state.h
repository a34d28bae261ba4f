#pragma once

// What all calls of one server share. Everything in it is thread-safe or const.

#include <atomic>
#include <string>

#include "admission.h"
#include "cage_cache.h"
#include "compute_arena.h"
#include "counters.h"
#include "request_limits.h"
#include "smooth/kernel_cache.h"

namespace barycast::server {

struct ServiceState {
  const Limits limits;
  ComputeArena arena;
  CageCache cages;
  KernelCache kernels;  // of denoising
  Admission admission;
  Counters counters;
  std::atomic<bool> ready{false};     // the self-test has passed; until then computations are refused
  std::atomic<bool> draining{false};  // new computations are refused
};

}  // namespace barycast::server
