#pragma once

// The transport of one UploadCage call: collects the pieces, within the limit, then decodes, names and
// indexes the cage on the arena; and fills its tables where that is asked for, in turns with other work.

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include "barycast/v1/barycast.pb.h"
#include "service_state.h"

namespace barycast::server {

// Deletes itself when gRPC is done with it.
grpc::ServerReadReactor<v1::UploadCageRequest>* new_upload_call(ServiceState& state,
                                                                grpc::CallbackServerContext& context,
                                                                v1::UploadCageResponse& response);

}  // namespace barycast::server
