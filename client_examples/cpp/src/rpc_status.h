#pragma once

// Reads what a server said about a call that failed: the status, and its google.rpc details.

#include <grpcpp/support/status.h>

#include "failure.h"

namespace barycast::client {

// Of a status that is not OK.
Failure to_failure(const grpc::Status& status);

}  // namespace barycast::client
