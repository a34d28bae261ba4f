#pragma once

// Beginning and end of a call: admission while draining, counters, and its one line in the log.

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <atomic>
#include <chrono>
#include <string>

#include "service_state.h"
#include "status.h"

namespace barycast::server {

class CallLog {
 public:
  CallLog(ServiceState& state, const char* method, grpc::CallbackServerContext& context);
  // Counts and logs, when gRPC is done with the call; drain waits for this.
  ~CallLog();
  CallLog(const CallLog&) = delete;
  CallLog& operator=(const CallLog&) = delete;

  // The client will not see any status. gRPC may say so only after the stream broke, which looks like a
  // half-close until then.
  void mark_cancelled() { cancelled_ = true; }
  bool cancelled() const { return cancelled_; }
  const std::atomic<bool>& cancel_flag() const { return cancelled_; }
  // What is about to be sent. `description`: "cage=... points=...".
  void set_outcome(const grpc::Status& status, std::string description);

 private:
  ServiceState& state_;
  const char* method_;
  const std::string peer_;
  const std::chrono::system_clock::time_point deadline_;
  const std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
  std::atomic<bool> cancelled_{false};
  grpc::StatusCode code_ = grpc::StatusCode::OK;
  std::string message_;
  std::string description_;
};

// What a call answers while the server drains, what a cancelled one ends with, and what one whose client
// has sent nothing for too long.
Refusal draining_refusal();
Refusal cancelled_refusal();
Refusal silent_refusal(std::chrono::milliseconds limit);

}  // namespace barycast::server
