#pragma once

// The one place that maps an Error to a gRPC status. The message is for people; google.rpc details are
// for programs: BadRequest with the field's path, PreconditionFailure of type MISSING with the cage's
// digest, RetryInfo where waiting helps.

#include <grpcpp/support/status.h>

#include "refusal.h"

namespace barycast::server {

grpc::Status to_status(const Refusal& refusal);

}  // namespace barycast::server
