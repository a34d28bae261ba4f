#pragma once

// The transport of one ComputeCoordinates call: a gRPC reactor around a ComputeJob. gRPC's threads only
// start tasks on the arena and writes on the stream; one task at a time runs for a call, and it posts
// its own continuation, so calls share the arena in turns. At most one message waits behind the one
// being written: a slow reader stops production, holding two blocks at most.

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include "barycast/v1/barycast.pb.h"
#include "service_state.h"

namespace barycast::server {

// Deletes itself when gRPC is done with it.
grpc::ServerBidiReactor<v1::ComputeCoordinatesRequest, v1::ComputeCoordinatesResponse>* new_compute_call(
    ServiceState& state, grpc::CallbackServerContext& context);

}  // namespace barycast::server
