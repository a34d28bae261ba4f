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

}  // namespace

Failure to_failure(const grpc::Status& status) {
  Failure failure{.error = {.code = static_cast<Code>(status.error_code()), .message = status.error_message()}};
  if (status.error_code() == grpc::StatusCode::UNAVAILABLE && nobody_there(status.error_message())) {
    failure.error.message = "no server answers at that address; is barycastd running, and the address right? (" +
                            status.error_message() + ")";
  }
  // Bytes that are no google.rpc.Status count as no details: the status itself still says what happened.
  google::rpc::Status details;
  if (details.ParseFromString(status.error_details())) {
    for (const auto& any : details.details()) read_detail(any, failure);
  }
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
