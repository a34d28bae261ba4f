#pragma once

// Cuts a binding's work into pieces of about twenty milliseconds, learning from the pieces before. It changes no
// result.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>

#include "base/parallel.h"

namespace barycast {

// How many points a task samples together: enough to fill vectors with their walks, few enough that the samples fit a
// near cache and a piece of work stays small.
inline size_t points_per_task(uint32_t samples) {
  return std::clamp<size_t>(2048 / samples, 1, 64);
}

// Adds the life time of the object to `seconds`.
class StageTimer {
 public:
  using Clock = std::chrono::steady_clock;
  explicit StageTimer(double& seconds) : seconds_(seconds), start_(Clock::now()) {}
  ~StageTimer() { seconds_ += elapsed(); }
  double elapsed() const { return std::chrono::duration<double>(Clock::now() - start_).count(); }
  StageTimer(const StageTimer&) = delete;
  StageTimer& operator=(const StageTimer&) = delete;

 private:
  double& seconds_;
  Clock::time_point start_;
};

class Quantum {
 public:
  explicit Quantum(size_t first_guess) : size_(std::clamp<size_t>(first_guess, 1, 16)) {}

  // How many points the next piece handles: at least one for every thread.
  size_t size() const { return std::max(size_, parallel_width()); }

  // Runs body(begin, end) over [0, count) in parallel, in tasks of at most `grain`; body says whether to go on. False
  // when it did not, or `cancel` was set.
  template <class Body>
  bool run(size_t count, size_t grain, const std::atomic<bool>& cancel, const Body& body) {
    return run(count, count, grain, cancel, body, [](size_t, size_t) {});
  }
  // The same, `batch` at a time; calls finish(begin, end) after each, on this thread.
  template <class Body, class Finish>
  bool run(size_t count, size_t batch, size_t grain, const std::atomic<bool>& cancel, const Body& body,
           const Finish& finish) {
    double seconds = 0.0;
    std::atomic<bool> complete = true;
    {
      const StageTimer timer(seconds);
      for (size_t first = 0; first < count && complete; first += batch) {
        const size_t size = std::min(batch, count - first);
        parallel_for(size, std::clamp<size_t>(size / parallel_width(), 1, grain), [&](size_t begin, size_t end) {
          if (!complete.load(std::memory_order_relaxed) || !body(first + begin, first + end)) complete = false;
        });
        if (complete) finish(first, first + size);
      }
    }
    learn(count, seconds);
    return complete && !cancel;
  }

 private:
  void learn(size_t done, double seconds) {
    if (done < size_) return;
    if (seconds < 0.5 * kSeconds) size_ = std::min<size_t>(2 * size_, 1 << 16);
    if (seconds > 1.5 * kSeconds) size_ = std::max<size_t>(size_ / 2, 1);
  }

  static constexpr double kSeconds = 0.02;
  size_t size_;
};

}  // namespace barycast
