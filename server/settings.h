#pragma once

// The table of barycastd's settings: names, meaning, ranges. Every source of settings (file, environment,
// command line) is parsed by it, over the values of the sources below.

#include <memory>
#include <string>
#include <vector>

#include "config.h"

namespace CLI {
class App;
}

namespace barycast::server {

// Parses into `config`, whose values are the defaults.
std::unique_ptr<CLI::App> make_app(Config& config);

// Names of all settings, as in "cache-bytes".
std::vector<std::string> setting_keys();

}  // namespace barycast::server
