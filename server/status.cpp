#include "status.h"

#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"

namespace barycast::server {
namespace {

grpc::StatusCode to_code(const Refusal& refusal) {
  if (refusal.draining) return grpc::StatusCode::UNAVAILABLE;
  switch (refusal.error.code) {
    case ErrorCode::kInvalidArgument:
      return grpc::StatusCode::INVALID_ARGUMENT;
    case ErrorCode::kResourceExhausted:
      return grpc::StatusCode::RESOURCE_EXHAUSTED;
    case ErrorCode::kUnimplemented:
      return grpc::StatusCode::UNIMPLEMENTED;
    case ErrorCode::kFailedPrecondition:
      return grpc::StatusCode::FAILED_PRECONDITION;
    case ErrorCode::kCancelled:
      return grpc::StatusCode::CANCELLED;
    case ErrorCode::kInternal:
      return grpc::StatusCode::INTERNAL;
  }
  return grpc::StatusCode::INTERNAL;
}

}  // namespace

grpc::Status to_status(const Refusal& refusal) {
  const Error& error = refusal.error;
  google::rpc::Status details;
  details.set_code(to_code(refusal));
  details.set_message(error.text());
  if (!error.field.empty()) {
    google::rpc::BadRequest bad;
    bad.add_field_violations()->set_field(error.field);
    bad.mutable_field_violations(0)->set_description(error.message);
    details.add_details()->PackFrom(bad);
  }
  if (refusal.missing_digest) {
    google::rpc::PreconditionFailure failure;
    failure.add_violations()->set_type("MISSING");
    failure.mutable_violations(0)->set_subject(*refusal.missing_digest);
    failure.mutable_violations(0)->set_description(error.message);
    details.add_details()->PackFrom(failure);
  }
  if (refusal.retry_after_ms) {
    google::rpc::RetryInfo retry;
    retry.mutable_retry_delay()->set_seconds(*refusal.retry_after_ms / 1000);
    retry.mutable_retry_delay()->set_nanos(static_cast<int32_t>(*refusal.retry_after_ms % 1000) * 1'000'000);
    details.add_details()->PackFrom(retry);
  }
  return {to_code(refusal), error.text(), details.SerializeAsString()};
}

}  // namespace barycast::server
