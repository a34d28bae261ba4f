#pragma once

// Why a call is refused: an Error, and what a program needs beyond it. status.h turns it into a
// grpc::Status; everything else in the server passes it on unread.

#include <cstdint>
#include <optional>
#include <string>

#include "base/result.h"

namespace barycast::server {

struct Refusal {
  Error error;
  std::optional<std::string> missing_digest;  // hexadecimal: a cage to upload
  std::optional<uint32_t> retry_after_ms;     // waiting helps
  bool draining = false;                      // another replica helps
};

}  // namespace barycast::server
