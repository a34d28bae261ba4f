#pragma once

// Points and faces as the messages of a request, in blocks within the server's message_bytes_max. The
// cuts cannot change a row; they are the Python client's. Free of gRPC.

#include <functional>

#include "messages.h"

namespace barycast::client {

// Sends one message; false where the call has ended.
using SendMessage = std::function<bool(const v1::ComputeCoordinatesRequest&)>;

// False where `send` said so.
bool send_points(const Points& points, uint64_t message_bytes_max, const SendMessage& send);
bool send_faces(const Faces& faces, uint64_t message_bytes_max, const SendMessage& send);

}  // namespace barycast::client
