#pragma once

// What the server is doing and has done, for drain, for tests and for people. Lock-free; each number is
// exact by itself, several read together need not be of one instant.

#include <atomic>
#include <cstdint>

namespace barycast::server {

struct Counters {
  std::atomic<int64_t> calls_active{0};  // computations and uploads whose status is not yet sent
  std::atomic<uint64_t> calls_ok{0};
  std::atomic<uint64_t> calls_cancelled{0};  // by the client, or past their deadline
  std::atomic<uint64_t> calls_refused{0};
  std::atomic<uint64_t> blocks_produced{0};  // row blocks handed to the transport or ready for it
  std::atomic<uint64_t> steps{0};            // pieces of work done for computations
};

}  // namespace barycast::server
