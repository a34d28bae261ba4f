#pragma once

// Something large that is built when it is first asked for, once, whoever asks. Who asks while it is built leaves a
// callback and blocks no thread.

#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "base/guarded_build.h"
#include "base/result.h"

namespace barycast {

// T has bytes(). Thread-safe.
template <class T>
class Lazy {
 public:
  using Then = std::function<void(Status)>;

  // build(): Result<std::unique_ptr<const T>>, called here and now unless a build has succeeded or is under way. `then`
  // is called once: before this returns, or later on the thread of another one's build.
  template <class Build>
  void prepare(const Build& build, Then then) const {
    std::unique_lock lock(mutex_);
    if (built_) {
      lock.unlock();
      return then(Done{});
    }
    waiters_.push_back(std::move(then));
    if (std::exchange(building_, true)) return;
    lock.unlock();
    Result<std::unique_ptr<const T>> built = guarded_build(build);
    const Status status = built.ok() ? Status(Done{}) : Status(built.error());
    std::vector<Then> waiters;
    lock.lock();
    if (built.ok()) built_ = std::move(built).value();
    building_ = false;
    waiters.swap(waiters_);
    lock.unlock();
    for (const Then& waiter : waiters) waiter(status);
  }

  // After a `prepare` that succeeded.
  const T& operator*() const {
    const std::scoped_lock lock(mutex_);
    return *built_;
  }
  // Null before.
  const T* get() const {
    const std::scoped_lock lock(mutex_);
    return built_.get();
  }
  // 0 before.
  size_t bytes() const {
    const std::scoped_lock lock(mutex_);
    return built_ ? built_->bytes() : 0;
  }

 private:
  mutable std::mutex mutex_;
  mutable std::unique_ptr<const T> built_;
  mutable bool building_ = false;
  mutable std::vector<Then> waiters_;
};

// What a call that takes a callback calls back with; waits for it.
template <class Call>
Status wait_for(const Call& call) {
  std::promise<Status> status;
  call([&](Status result) { status.set_value(std::move(result)); });
  return status.get_future().get();
}

}  // namespace barycast
