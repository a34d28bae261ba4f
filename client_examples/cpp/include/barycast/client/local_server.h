#pragma once

// A private barycastd for callers that name no server. It listens on a Unix socket in a fresh folder
// that only this user can enter, and ends with its owner: when the LocalServer is destroyed, or, whatever
// happens to this process, when the daemon's standard input closes. Starting it takes the time of its
// self-test, a fraction of a second. Start it before other threads that fork or change signal masks, and
// let it outlive the Clients that use it.

#include <chrono>
#include <memory>
#include <stop_token>
#include <string>

#include "barycast/client/result.h"

namespace barycast::client {

// Path of barycastd: the environment variable BARYCASTD, else the folder of the running program, else PATH.
// Errors: there is none, with what to do.
Result<std::string> find_daemon();

struct LocalServerSettings {
  std::string program;   // path of barycastd
  unsigned threads = 0;  // 0: the daemon chooses
  std::chrono::milliseconds start_time_max{30'000};
};

class LocalServer {
 public:
  // Waits until it serves. Errors: it cannot be started, ends at once (with the last line that it wrote), or does not
  // serve in time; kCancelled.
  static Result<std::unique_ptr<LocalServer>> start(const LocalServerSettings& settings,
                                                    const std::stop_token& stop = {});
  virtual ~LocalServer() = default;

  // For ClientSettings.
  virtual const std::string& address() const = 0;
};

}  // namespace barycast::client
