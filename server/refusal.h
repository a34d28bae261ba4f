#pragma once

// Why a call is refused: an Error, and what a program needs beyond it. status.h turns it into a
// grpc::Status; everything else in the server passes it on unread.

#include <cstdint>
#include <exception>
#include <new>
#include <optional>
#include <string>

#include "base/result.h"

namespace barycast::server {

struct Refusal {
  Error error;
  std::optional<std::string> missing_digest;  // hexadecimal: a cage to upload
  std::optional<uint32_t> retry_after_ms;     // waiting helps
  bool draining = false;                      // another replica helps, or this one later
};

// An error of `resolve` or of check_estimator, with its path in a request.
inline Error at_options(Error error) {
  error.field = error.field.empty() ? "header.options" : "header.options." + error.field;
  return error;
}

// Runs `work` and turns running out of memory, or any other exception, into a refusal: nothing may
// escape into the arena or into gRPC's threads, which would end the process.
template <class Work>
std::optional<Refusal> guarded(const Work& work) {
  try {
    return work();
  } catch (const std::bad_alloc&) {
    return Refusal{{ErrorCode::kResourceExhausted, "", "out of memory; cut the request into several"}, {}, {}};
  } catch (const std::exception& e) {
    return Refusal{{ErrorCode::kInternal, "", e.what()}, {}, {}};
  }
}

}  // namespace barycast::server
