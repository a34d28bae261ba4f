#pragma once

// The Prometheus page on a port of its own: http://HOST:PORT/metrics. Everything is read from the server's
// counters when the page is asked for; between two looks it costs nothing, and the computations never wait
// for it.

#include <memory>
#include <string>

#include "base/result.h"
#include "service_state.h"

namespace barycast::server {

class Metrics {
 public:
  // `address`: HOST:PORT, port 0 for any. `state` must outlive the result.
  // Errors: kInvalidArgument, an address that cannot be bound.
  static Result<std::unique_ptr<Metrics>> listen(const std::string& address, const ServiceState& state);
  virtual ~Metrics() = default;
  // With the port that was chosen.
  virtual const std::string& address() const = 0;
};

}  // namespace barycast::server
