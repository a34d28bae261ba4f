#pragma once

// Which requests may work at once: a number of requests and a sum of estimated bytes, decided from the
// header before any work. Admitted requests share the arena in small turns; beyond the bounds a request
// is refused at once, because a client that waits elsewhere is cheaper than a queue here. Thread-safe.

#include <cstdint>
#include <memory>
#include <mutex>
#include <variant>

#include "refusal.h"

namespace barycast::server {

class Admission {
 public:
  struct Bounds {
    uint32_t requests_max = 64;
    uint64_t bytes_max = 4ull << 30;
  };

  // Gives back what was admitted when it is destroyed. Outlived by its Admission.
  class Ticket {
   public:
    Ticket(Admission& admission, uint64_t bytes) : admission_(&admission), bytes_(bytes) {}
    Ticket(const Ticket&) = delete;
    Ticket& operator=(const Ticket&) = delete;
    ~Ticket() { admission_->leave(bytes_); }

   private:
    Admission* admission_;
    uint64_t bytes_;
  };

  explicit Admission(const Bounds& bounds) : bounds_(bounds) {}

  struct Usage {
    uint32_t requests = 0;  // admitted now
    uint64_t bytes = 0;     // promised to them
    uint64_t refused = 0;   // since the start, for being busy
  };
  Usage usage() const;

  // A refusal carries when to try again.
  std::variant<std::unique_ptr<Ticket>, Refusal> enter(uint64_t bytes);

 private:
  void leave(uint64_t bytes);

  const Bounds bounds_;
  mutable std::mutex mutex_;
  Usage usage_;
};

}  // namespace barycast::server
