#include "rpc_status.h"

#include <algorithm>

#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"

namespace barycast::client {
namespace {

std::chrono::milliseconds to_milliseconds(const google::protobuf::Duration& duration) {
  // A server's wish, but not for ever.
  constexpr int64_t kSecondsMax = 3600;
  const int64_t seconds = std::clamp<int64_t>(duration.seconds(), 0, kSecondsMax);
  return std::chrono::milliseconds(1000 * seconds + std::max(0, duration.nanos()) / 1'000'000);
}

void read_detail(const google::protobuf::Any& any, Failure& failure) {
  google::rpc::BadRequest bad;
  google::rpc::PreconditionFailure precondition;
  google::rpc::RetryInfo retry;
  if (any.UnpackTo(&bad) && bad.field_violations_size() > 0 && failure.error.field.empty()) {
    failure.error.field = bad.field_violations(0).field();
    if (!bad.field_violations(0).description().empty()) failure.error.message = bad.field_violations(0).description();
  } else if (any.UnpackTo(&precondition)) {
    for (const auto& violation : precondition.violations()) failure.cage_missing |= violation.type() == "MISSING";
  } else if (any.UnpackTo(&retry)) {
    failure.retry_after = to_milliseconds(retry.retry_delay());
  }
}

// What gRPC says when there was no connection at all.
bool nobody_there(const std::string& message) {
  return message.find("failed to connect") != message.npos || message.find("DNS resolution failed") != message.npos;
}

// What gRPC says when a stream broke off: a proxy lost the server behind it, or let a refusal pass and then reset the
// stream, because the client was still sending.
bool stream_lost(const grpc::Status& status) {
  const grpc::StatusCode code = status.error_code();
  if (code != grpc::StatusCode::UNKNOWN && code != grpc::StatusCode::INTERNAL && code != grpc::StatusCode::CANCELLED)
    return false;
  const std::string message = status.error_message();
  return message.find("Stream removed") != message.npos || message.find("RST_STREAM") != message.npos;
}

// Code and message, as the server sent them where it did. `details`: what came with the status, or empty.
Error read_status(const grpc::Status& status, const google::rpc::Status& details) {
  if (stream_lost(status)) {
    if (details.code() >= 1 && details.code() <= 16)
      return {.code = static_cast<Code>(details.code()), .message = details.message()};
    return {.code = Code::kUnavailable, .message = "the connection was lost (" + status.error_message() + ")"};
  }
  Error error{.code = static_cast<Code>(status.error_code()), .message = status.error_message()};
  if (error.code == Code::kUnavailable && nobody_there(error.message)) {
    error.message =
        "no server answers at that address; is barycastd running, and the address right? (" + error.message + ")";
  }
  return error;
}

}  // namespace

Failure to_failure(const grpc::Status& status) {
  // Bytes that are no google.rpc.Status count as no details: the status itself still says what happened.
  google::rpc::Status details;
  if (!details.ParseFromString(status.error_details())) details.Clear();
  Failure failure{.error = read_status(status, details)};
  for (const auto& any : details.details()) read_detail(any, failure);
  Error& error = failure.error;
  if (error.message.empty()) error.message = "the call failed with gRPC status " + std::to_string(status.error_code());
  // Another build, or one whose smoothing time differs in its last bit: its rows must not be mixed with the first.
  failure.build_changed = error.code == Code::kFailedPrecondition && error.field.find(".resume.") != std::string::npos;
  // Waiting helps only where the server says so.
  if (error.code != Code::kResourceExhausted) failure.retry_after.reset();
  error.is_input = error.code == Code::kInvalidArgument || error.code == Code::kOutOfRange ||
                   error.code == Code::kUnimplemented ||
                   (error.code == Code::kResourceExhausted && !failure.retry_after);
  return failure;
}

}  // namespace barycast::client
