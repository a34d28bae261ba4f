#pragma once

// The settings of barycastd: flags over environment (BARYCASTD_<KEY>, dashes as underscores) over a file
// (--config, TOML or INI: `cache-bytes = "2GB"`) over defaults, some of which depend on the machine. A value
// that is not understood is an error that names its key and where it came from, and so is an unknown key in
// the file. Unknown variables are not: orchestrators set some of their own (BARYCASTD_PORT).

#include <optional>
#include <string>

#include "daemon.h"
#include "log.h"

namespace barycast::server {

struct Config {
  DaemonSettings daemon;
  std::string port_file;          // where the bound address is written; or empty
  std::string metrics_port_file;  // the same of the metrics page
  uint32_t drain_s = 30;          // how long running calls may go on after SIGTERM
  std::string log_level = "info";
  std::string log_format = "text";
  uint32_t receive_idle_ms = 60'000;
  bool exit_on_stdin_close = false;  // a private server that must not outlive its owner

  // What to do instead of serving; flags only.
  std::string probe;  // ask this server, or kProbeListen, for its health and exit; or empty
  bool self_test = false;
  bool print_config = false;
};

// Config::probe of the server that has these settings.
inline constexpr const char* kProbeListen = "listen";

// Usage and configuration errors end the program with this; 1 is for everything that goes wrong later.
inline constexpr int kExitUsage = 2;

// A Config, or the exit code of a command line that asked for help or was wrong (already reported).
struct ParsedConfig {
  std::optional<Config> config;
  int exit_code = 0;
};
ParsedConfig parse_config(int argc, char** argv);

// Every setting as a file that --config reads.
std::string config_text(Config config);

}  // namespace barycast::server
