#include "retry.h"

#include <algorithm>
#include <condition_variable>
#include <mutex>

namespace barycast::client {
namespace {

using std::chrono::milliseconds;

// The first bound is above a round trip, the last one well below the time that an impatient person waits for a daemon
// that came back.
constexpr milliseconds kDelayMin{100}, kDelayMax{3200};

}  // namespace

Retry::Retry(milliseconds retry_max, milliseconds time_max, std::stop_token stop)
    : retry_max_(retry_max), stop_(std::move(stop)), progress_(Clock::now()) {
  if (time_max.count() > 0) deadline_ = progress_ + time_max;
}

bool Retry::wait(const Failure& failure) {
  if (failure.error.code != Code::kUnavailable && !failure.retry_after) return false;
  const milliseconds bound = std::min(kDelayMax, kDelayMin * (1 << std::min(failures_, 10)));
  ++failures_;
  std::uniform_int_distribution<int64_t> part(0, bound.count());
  const milliseconds delay = failure.retry_after.value_or(milliseconds(0)) + milliseconds(part(random_));
  const Clock::time_point then = Clock::now() + delay;
  if (then > progress_ + retry_max_ || (deadline_ && then > *deadline_)) return false;
  return sleep_for(delay, stop_);
}

void Retry::progressed() {
  progress_ = Clock::now();
  failures_ = 0;
}

bool sleep_for(milliseconds time, const std::stop_token& stop) {
  std::mutex mutex;
  std::condition_variable_any condition;
  std::unique_lock lock(mutex);
  condition.wait_for(lock, stop, time, [] { return false; });
  return !stop.stop_requested();
}

}  // namespace barycast::client
