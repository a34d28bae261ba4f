#pragma once

// Bounds a wait for the client's next message, so that a client which falls silent does not keep its place
// for ever. Either the read ends the wait or the time does, never both: whoever comes first owns the call.
//
//   timeout.watch(60s, [this] { StartRead(&request); }, [this] { refuse(); });
//   OnReadDone:  if (!timeout.stop()) return;
//
// `watch` and `stop` alternate; `on_timeout` runs on one of gRPC's threads, while the read is under way.

#include <grpcpp/alarm.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <mutex>

namespace barycast::server {

class ReadTimeout {
 public:
  void watch(std::chrono::milliseconds limit, const std::function<void()>& start_read,
             std::function<void()> on_timeout) {
    const auto wait = std::make_shared<Wait>();
    wait_ = wait;
    start_read();
    // From here on the read may have ended, and the call with this object in it be gone.
    const std::lock_guard lock(wait->mutex);
    if (!*wait->open) return;
    // Not the wait itself: an alarm keeps its callback, and would keep itself.
    wait->alarm.Set(std::chrono::system_clock::now() + limit,
                    [open = wait->open, on_timeout = std::move(on_timeout)](bool expired) {
                      if (expired && open->exchange(false)) on_timeout();
                    });
  }

  // False: the time was up first, and `on_timeout` was or is being called.
  bool stop() {
    if (!wait_->open->exchange(false)) return false;
    const std::lock_guard lock(wait_->mutex);
    wait_->alarm.Cancel();
    return true;
  }

 private:
  struct Wait {
    std::shared_ptr<std::atomic<bool>> open = std::make_shared<std::atomic<bool>>(true);
    std::mutex mutex;  // of the alarm
    grpc::Alarm alarm;
  };
  std::shared_ptr<Wait> wait_;
};

}  // namespace barycast::server
