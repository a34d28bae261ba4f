#pragma once

// barycast.v1.BarycastService on gRPC's callback API. The short calls are answered here; the streaming
// ones have a reactor each (compute_call.h, upload_call.h). Thread-safe.

#include <memory>

#include <grpcpp/impl/codegen/service_type.h>

#include "service_state.h"

namespace barycast::server {

// `state` outlives the service and its calls.
std::unique_ptr<grpc::Service> make_service(ServiceState& state);

}  // namespace barycast::server
