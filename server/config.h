#pragma once

// The command line of barycastd. Limits that depend on the machine (memory) get their defaults here.

#include <optional>
#include <string>

#include "daemon.h"

namespace barycast::server {

struct Config {
  DaemonSettings daemon;
  std::string port_file;  // where the bound address is written; or empty
  uint32_t drain_s = 30;  // how long running calls may go on after SIGTERM
  std::string log_level = "info";
  bool exit_on_stdin_close = false;  // a private server that must not outlive its owner
  std::string probe;                 // ask this server for its health and exit; or empty
};

// A Config, or the exit code of a command line that asked for help or was wrong (already reported).
struct ParsedConfig {
  std::optional<Config> config;
  int exit_code = 0;
};
ParsedConfig parse_config(int argc, char** argv);

}  // namespace barycast::server
