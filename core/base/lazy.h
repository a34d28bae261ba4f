#pragma once

// Something large that is built when it is first asked for, once, whoever asks.

#include <atomic>
#include <memory>
#include <mutex>

#include "base/result.h"

namespace barycast {

// T has bytes(). Thread-safe; those that ask while it is built wait. `build` must not hand work to other threads, whose
// tasks might ask again.
template <class T>
class Lazy {
 public:
  // build(): Result<std::unique_ptr<const T>>, called unless a build has succeeded before.
  template <class Build>
  Status prepare(const Build& build) const {
    if (ready_.load(std::memory_order_acquire) != nullptr) return Done{};
    const std::scoped_lock lock(mutex_);
    if (owned_) return Done{};
    auto built = build();
    if (!built) return built.error();
    owned_ = std::move(built).value();
    ready_.store(owned_.get(), std::memory_order_release);
    return Done{};
  }
  // After a `prepare` that succeeded.
  const T& operator*() const { return *ready_.load(std::memory_order_acquire); }
  // 0 before.
  size_t bytes() const {
    const T* const built = ready_.load(std::memory_order_acquire);
    return built == nullptr ? 0 : built->bytes();
  }

 private:
  mutable std::mutex mutex_;
  mutable std::unique_ptr<const T> owned_;
  mutable std::atomic<const T*> ready_{nullptr};
};

}  // namespace barycast
