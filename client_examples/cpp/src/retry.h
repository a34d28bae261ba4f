#pragma once

// When to try again: after lost connections (kUnavailable), and after a busy server's own time, for a
// bounded time without progress. Waits have full jitter (a random part of an exponentially growing
// bound), so that a farm's clients do not return together. One Retry per verb, not thread-safe.

#include <chrono>
#include <random>
#include <stop_token>

#include "failure.h"

namespace barycast::client {

class Retry {
 public:
  using Clock = std::chrono::steady_clock;

  // retry_max: without progress. time_max: from now on, of everything; 0: no limit.
  Retry(std::chrono::milliseconds retry_max, std::chrono::milliseconds time_max, std::stop_token stop);

  // Waits and returns true when another attempt makes sense; false when the failure is final.
  bool wait(const Failure& failure);
  // Something new arrived: the time and the delays start again.
  void progressed();

  std::optional<Clock::time_point> deadline() const { return deadline_; }
  const std::stop_token& stop() const { return stop_; }

 private:
  const std::chrono::milliseconds retry_max_;
  const std::stop_token stop_;
  std::optional<Clock::time_point> deadline_;
  Clock::time_point progress_;
  int failures_ = 0;
  std::minstd_rand random_{std::random_device{}()};
};

// Sleeps; false when it was interrupted.
bool sleep_for(std::chrono::milliseconds time, const std::stop_token& stop);

}  // namespace barycast::client
