#include "call_log.h"

#include <fmt/format.h>

#include "log.h"

namespace barycast::server {

CallLog::CallLog(ServiceState& state, Method method, grpc::CallbackServerContext& context)
    : state_(state), method_(method), peer_(context.peer()), deadline_(context.deadline()) {
  state_.counters.calls_active.fetch_add(1);
}

CallLog::~CallLog() {
  Counters& counters = state_.counters;
  if (cancelled_) {
    counters.calls_cancelled.fetch_add(1);
    code_ = std::chrono::system_clock::now() >= deadline_ ? grpc::StatusCode::DEADLINE_EXCEEDED
                                                          : grpc::StatusCode::CANCELLED;
    message_.clear();
  } else {
    (code_ == grpc::StatusCode::OK ? counters.calls_ok : counters.calls_refused).fetch_add(1);
  }
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  const auto method = static_cast<size_t>(method_);
  counters.calls[method][static_cast<size_t>(code_)].fetch_add(1);
  counters.durations[method].observe(seconds);
  for (size_t i = 0; facts_.stages && i < kStageNames.size(); ++i)
    counters.stage_ns[i].fetch_add(static_cast<uint64_t>(1e9 * (*facts_.stages)[i]));
  counters.samples.fetch_add(facts_.samples);
  counters.rows.fetch_add(facts_.rows);
  counters.entries.fetch_add(facts_.entries);
  log_request({.method = method_,
               .outcome = code_name(static_cast<size_t>(code_)),
               .message = std::move(message_),
               .peer = peer_,
               .seconds = seconds,
               .facts = std::move(facts_)});
  // Last: whoever waits for this may read the other counters next.
  counters.calls_active.fetch_sub(1);
}

void CallLog::set_outcome(const grpc::Status& status, RequestFacts facts) {
  code_ = status.error_code();
  message_ = status.error_message();
  facts_ = std::move(facts);
}

std::optional<Refusal> closed(const ServiceState& state) {
  if (state.ready && !state.draining) return std::nullopt;
  const char* why = state.draining ? "this server is shutting down; call another, or this one later"
                                   : "this server is starting; call again in a moment";
  return Refusal{
      .error = {ErrorCode::kInternal, "", why}, .missing_digest = {}, .retry_after_ms = {}, .draining = true};
}

std::string cage_digest_metadata(const grpc::CallbackServerContext& context) {
  const auto found = context.client_metadata().find("x-cage-digest");
  return found == context.client_metadata().end() ? "" : std::string(found->second.data(), found->second.size());
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
