#pragma once

// The server as a whole, without gRPC in sight: listen, serve, drain, stop. main.cpp runs one; tests run
// theirs in process over a real socket.
//
//   auto daemon = Daemon::start(settings);
//   ... daemon->begin_drain(); wait for !daemon->busy(); daemon->stop(grace)

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include "admission.h"
#include "base/result.h"
#include "counters.h"
#include "request_limits.h"
#include "self_test.h"

namespace barycast::server {

struct DaemonSettings {
  std::string listen = "127.0.0.1:50051";  // HOST:PORT, port 0 for any; or unix:/path
  std::string metrics_listen;              // HOST:PORT, port 0 for any; empty: no metrics page
  int threads = 0;                         // of the compute arena; 0: as many as this process may use
  uint64_t cache_bytes_max = 1ull << 30;
  uint64_t smoothing_cache_bytes_max = 1ull << 28;
  Limits limits;
  Admission::Bounds admission;
  std::function<Status()> self_test = server::self_test;  // what must pass before the server is ready
};

class Daemon {
 public:
  // Listens, with health at NOT_SERVING and computations refused, until a computation of its own came out
  // right; serves when it returns. (For some microseconds after the port opens, less than a connection takes,
  // gRPC's health service already says SERVING for "", the server as a whole.)
  // Errors: kInvalidArgument (an address that cannot be bound), kInternal (the self-test failed).
  static Result<std::unique_ptr<Daemon>> start(const DaemonSettings& settings);
  // Stops at once; running calls are cancelled.
  virtual ~Daemon() = default;

  // Where it listens, with the port that was chosen: "127.0.0.1:43215", "unix:/path".
  virtual const std::string& address() const = 0;
  // The same of the metrics page; empty where there is none.
  virtual const std::string& metrics_address() const = 0;
  virtual int threads() const = 0;
  virtual const Counters& counters() const = 0;

  // Health says NOT_SERVING, new computations and uploads are refused, running ones go on.
  virtual void begin_drain() = 0;
  virtual bool busy() const = 0;
  // Closes the listener; calls that still run are cancelled after `grace`. Returns when all have ended.
  virtual void stop(std::chrono::milliseconds grace) = 0;
};

// What a server says about its health; kNoAnswer: nothing listens, or it said nothing in time.
enum class Health { kServing, kNotServing, kNoAnswer };

// Asks the server at `address`, for at most `timeout`.
Health probe(const std::string& address, std::chrono::milliseconds timeout);

}  // namespace barycast::server
