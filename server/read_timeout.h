#pragma once

// Bounds a wait for the client's next message, so that a client which falls silent does not keep its place
// for ever. Either the read ends the wait or the time does, never both: whoever comes first owns the call.
//
//   timeout.start(60s, [this] { refuse(); });  StartRead(&request);
//   OnReadDone:  if (!timeout.stop()) return;
//
// `start` and `stop` alternate; `on_timeout` runs on one of gRPC's threads.

#include <grpcpp/alarm.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>

namespace barycast::server {

class ReadTimeout {
 public:
  void start(std::chrono::milliseconds limit, std::function<void()> on_timeout) {
    waiting_ = std::make_shared<std::atomic<bool>>(true);
    alarm_ = std::make_unique<grpc::Alarm>();
    // May run after this object is gone, but then the wait is over and nothing is called.
    alarm_->Set(std::chrono::system_clock::now() + limit,
                [waiting = waiting_, on_timeout = std::move(on_timeout)](bool expired) {
                  if (expired && waiting->exchange(false)) on_timeout();
                });
  }

  // False: the time was up first, and `on_timeout` was or is being called.
  bool stop() {
    const bool in_time = waiting_->exchange(false);
    if (in_time) alarm_.reset();
    return in_time;
  }

 private:
  std::shared_ptr<std::atomic<bool>> waiting_;
  std::unique_ptr<grpc::Alarm> alarm_;
};

}  // namespace barycast::server
