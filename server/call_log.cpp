#include "call_log.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

namespace barycast::server {

CallLog::CallLog(ServiceState& state, const char* method, grpc::CallbackServerContext& context)
    : state_(state), method_(method), peer_(context.peer()), deadline_(context.deadline()) {
  state_.counters.calls_active.fetch_add(1);
}

CallLog::~CallLog() {
  const char* outcome = code_name(code_);
  if (cancelled_) {
    state_.counters.calls_cancelled.fetch_add(1);
    outcome = std::chrono::system_clock::now() >= deadline_ ? "DEADLINE_EXCEEDED" : "CANCELLED";
  } else {
    (code_ == grpc::StatusCode::OK ? state_.counters.calls_ok : state_.counters.calls_refused).fetch_add(1);
  }
  const std::chrono::duration<double, std::milli> elapsed = std::chrono::steady_clock::now() - start_;
  const bool explain = !cancelled_ && !message_.empty();
  spdlog::info("{} {} ms={:.1f} peer={} {}{}{}", method_, outcome, elapsed.count(), peer_, description_,
               explain ? " message=" : "", explain ? message_ : "");
  // Last: whoever waits for this may read the other counters next.
  state_.counters.calls_active.fetch_sub(1);
}

void CallLog::set_outcome(const grpc::Status& status, std::string description) {
  code_ = status.error_code();
  message_ = status.error_message();
  description_ = std::move(description);
}

Refusal draining_refusal() {
  return {.error = {ErrorCode::kInternal, "", "this server is shutting down; call another, or this one later"},
          .missing_digest = {},
          .retry_after_ms = {},
          .draining = true};
}

Refusal cancelled_refusal() {
  return {.error = {ErrorCode::kCancelled, "", "cancelled by the client, or past its deadline"},
          .missing_digest = {},
          .retry_after_ms = {}};
}

Refusal silent_refusal(std::chrono::milliseconds limit) {
  return {.error = {ErrorCode::kCancelled, "",
                    fmt::format("nothing arrived for {} ms, so the call gave up its place; send the request without "
                                "pauses, and end it",
                                limit.count())},
          .missing_digest = {},
          .retry_after_ms = {}};
}

}  // namespace barycast::server
