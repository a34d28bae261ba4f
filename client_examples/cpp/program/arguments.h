#pragma once

// The command line of barycast_bind.

#include <chrono>
#include <optional>
#include <string>

#include "barycast/client/client.h"

namespace barycast::program {

// As in the Python command line.
enum Exit { kDone = 0, kUsage = 2, kInput = 3, kServer = 4, kInterrupted = 130, kTerminated = 143 };

struct Arguments {
  std::string cage, model, output;
  std::optional<std::string> server;  // none: a private one is started
  // What lost connections and busy answers may cost; of a server that is named.
  double retry_s = std::chrono::duration<double>(client::ClientSettings{}.retry_time_max).count();
  bool quiet = false;
  client::ComputeOptions options;
};

// The arguments, or the exit code of a command line that asked for help or was wrong (already reported).
struct ParsedArguments {
  std::optional<Arguments> arguments;
  int exit_code = kDone;
};
ParsedArguments parse_arguments(int argc, char** argv);

}  // namespace barycast::program
