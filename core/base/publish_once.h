#pragma once

// A value that appears once and stays: whoever needs it first makes it, without a lock. Several threads may make it at
// a time, so it must be a function of what they all know; the first one's is kept. Readers never wait.

#include <atomic>
#include <memory>

namespace barycast {

template <class T>
class PublishOnce {
 public:
  PublishOnce() = default;
  ~PublishOnce() { delete value_.load(std::memory_order_acquire); }
  PublishOnce(const PublishOnce&) = delete;
  PublishOnce& operator=(const PublishOnce&) = delete;

  // Null before.
  const T* get() const { return value_.load(std::memory_order_acquire); }

  // Whether `value` is the one that is kept; otherwise another was, before, and it is left to the caller.
  bool publish(std::unique_ptr<const T>& value) const {
    const T* none = nullptr;
    if (!value_.compare_exchange_strong(none, value.get(), std::memory_order_acq_rel)) return false;
    (void)value.release();
    return true;
  }

 private:
  mutable std::atomic<const T*> value_ = nullptr;
};

}  // namespace barycast
