#pragma once

// The command line of barycast_bind.

#include <optional>
#include <string>

#include "barycast/client/options.h"

namespace barycast::program {

// As in the Python command line.
enum Exit { kDone = 0, kUsage = 2, kInput = 3, kServer = 4, kInterrupted = 130, kTerminated = 143 };

struct Arguments {
  std::string cage, model, output;
  std::string server;     // empty: a private one is started
  double retry_s = 30.0;  // what lost connections and busy answers may cost; of a server that is named
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
