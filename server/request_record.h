#pragma once

// What is known of one request at its end: its line in the log, and what it adds to the counters. Plain
// data; a request that was refused early knows less.

#include <cstdint>
#include <optional>
#include <string>

#include "counters.h"

namespace barycast::server {

// What the work itself tells, whoever carries it.
struct RequestFacts {
  std::string cage;               // its digest in hexadecimal, or empty
  std::optional<bool> cache_hit;  // unset: the cache was not asked
  uint64_t points = 0, faces = 0, control_vertices = 0;
  uint64_t samples = 0, rows = 0, entries = 0;  // made, not asked for
  std::optional<StageSeconds> stages;           // unset: nothing was computed
};

struct RequestRecord {
  Method method = Method::kComputeCoordinates;
  const char* outcome = "OK";  // the name of the status code
  std::string message;         // why it was refused; or empty
  std::string peer;
  double seconds = 0.0;
  RequestFacts facts;
};

}  // namespace barycast::server
