#pragma once

// How one attempt of a call failed: the error for the caller, and what the client itself can do about it.

#include <chrono>
#include <optional>

#include "barycast/client/result.h"

namespace barycast::client {

struct Failure {
  Error error;
  // The server does not hold the cage that was named by its digest: upload it.
  bool cage_missing = false;
  // Rows of this server must not be mixed with those received before: start over.
  bool build_changed = false;
  // The server is busy and asks to come back after this time.
  std::optional<std::chrono::milliseconds> retry_after = {};
};

// Nothing, where the attempt succeeded.
using Outcome = std::optional<Failure>;

}  // namespace barycast::client
