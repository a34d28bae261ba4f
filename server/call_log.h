#pragma once

// Beginning and end of a call: whether it may begin, counters, and its one line in the log.

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <atomic>
#include <chrono>
#include <string>

#include "request_record.h"
#include "service_state.h"
#include "status.h"

namespace barycast::server {

class CallLog {
 public:
  CallLog(ServiceState& state, Method method, grpc::CallbackServerContext& context);
  // Counts and logs, when gRPC is done with the call; drain waits for this.
  ~CallLog();
  CallLog(const CallLog&) = delete;
  CallLog& operator=(const CallLog&) = delete;

  // The client will not see any status. gRPC may say so only after the stream broke, which looks like a
  // half-close until then.
  void mark_cancelled() { cancelled_ = true; }
  bool cancelled() const { return cancelled_; }
  const std::atomic<bool>& cancel_flag() const { return cancelled_; }
  // What is about to be sent, and what was done for it.
  void set_outcome(const grpc::Status& status, RequestFacts facts = {});

 private:
  ServiceState& state_;
  const Method method_;
  const std::string peer_;
  const std::chrono::system_clock::time_point deadline_;
  const std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
  std::atomic<bool> cancelled_{false};
  grpc::StatusCode code_ = grpc::StatusCode::OK;
  std::string message_;
  RequestFacts facts_;
};

// Why new work is refused, whatever it is: the self-test has not passed yet, or the server drains.
std::optional<Refusal> closed(const ServiceState& state);

// The call's x-cage-digest, or empty.
std::string cage_digest_metadata(const grpc::CallbackServerContext& context);

// What a cancelled call ends with, and one whose client has sent nothing for too long.
Refusal cancelled_refusal();
Refusal silent_refusal(std::chrono::milliseconds limit);

}  // namespace barycast::server
