#include "config.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <fstream>

#include "machine.h"
#include "settings.h"

namespace barycast::server {
namespace {

struct CommandLine {
  std::string file;
};

void add_commands(CLI::App& app, Config& config, CommandLine& line) {
  app.set_version_flag("--version", "barycastd " BARYCAST_VERSION);
  const auto once = [](CLI::Option* option) { option->configurable(false); };
  once(app.add_option("--config", line.file, "File of settings, TOML or INI (also BARYCASTD_CONFIG)"));
  once(app.add_flag("--print-config", config.print_config, "Print the settings in effect as such a file, and exit"));
  once(app.add_flag("--self-test", config.self_test, "Compute a known result with every kind; exit code 0: all right"));
  once(app.add_option("--probe", config.probe,
                      "Ask the server at this address, or without one at --listen, for its health; exit code 0: it "
                      "serves")
           ->expected(0, 1)
           ->default_str(kProbeListen));
}

std::string variable_of(std::string key) {
  std::transform(key.begin(), key.end(), key.begin(),
                 [](char c) { return c == '-' ? '_' : static_cast<char>(std::toupper(c)); });
  return "BARYCASTD_" + key;
}

// CLI11 leads with the flag's name; the source already names the key.
std::string without_flag(const std::string& what, const std::string& key) {
  const std::string flag = "--" + key + ": ";
  return what.starts_with(flag) ? what.substr(flag.size()) : what;
}

// Reports and gives false when the value is not understood.
bool set(Config& config, const std::string& key, const std::string& value, const std::string& origin) {
  try {
    std::vector<std::string> arguments = {"--" + key + "=" + value};
    make_app(config)->parse(arguments);
    return true;
  } catch (const CLI::ParseError& e) {
    std::fputs(fmt::format("barycastd: {}: {}\n", origin, without_flag(e.what(), key)).c_str(), stderr);
    return false;
  }
}

// CLI11 takes a # for a comment even inside quotes; a value that is cut off in silence would be worse than none.
void check_hashes(std::ifstream& in) {
  size_t number = 0;
  for (std::string line; std::getline(in, line);) {
    ++number;
    char quote = 0;  // the one that is open
    for (const char c : line) {
      if (c == '#' && quote == 0) break;
      if (c == '#') {
        throw CLI::FileError(
            fmt::format("line {}: a value in the file cannot hold a #; use the flag or the environment", number));
      }
      if (c == quote) {
        quote = 0;
      } else if (quote == 0 && (c == '"' || c == '\'')) {
        quote = c;
      }
    }
  }
  in.clear();
  in.seekg(0);
}

bool read_file(const std::string& path, Config& config) {
  std::vector<CLI::ConfigItem> items;
  try {
    std::ifstream in(path);
    if (!in) throw CLI::FileError("cannot be read");
    check_hashes(in);
    items = CLI::ConfigTOML().from_config(in);
  } catch (const CLI::Error& e) {
    std::fputs(fmt::format("barycastd: {}: {}\n", path, e.what()).c_str(), stderr);
    return false;
  }
  const std::vector<std::string> known = setting_keys();
  for (const CLI::ConfigItem& item : items) {
    if (item.name == "++" || item.name == "--") continue;  // CLI11's marks for the ends of sections
    const std::string origin = path + ": " + item.fullname();
    if (!item.parents.empty() || std::find(known.begin(), known.end(), item.name) == known.end()) {
      std::fputs(fmt::format("barycastd: {}: no such setting; there are {}\n", origin, fmt::join(known, ", ")).c_str(),
                 stderr);
      return false;
    }
    if (item.inputs.size() != 1) {
      std::fputs(fmt::format("barycastd: {}: {} values; give one\n", origin, item.inputs.size()).c_str(), stderr);
      return false;
    }
    // As in the environment, empty is unset.
    if (!item.inputs[0].empty() && !set(config, item.name, item.inputs[0], origin)) return false;
  }
  return true;
}

bool read_environment(Config& config) {
  for (const std::string& key : setting_keys()) {
    const std::string variable = variable_of(key);
    const char* const value = std::getenv(variable.c_str());
    // An empty variable is how a shell or a manifest leaves one out.
    if (value == nullptr || *value == '\0') continue;
    if (!set(config, key, value, "environment variable " + variable)) return false;
  }
  return true;
}

Config defaults() {
  Config config;
  DaemonSettings& daemon = config.daemon;
  // Half the memory for working requests, a quarter at most for messages on their way; the rest for the caches and the
  // program.
  daemon.admission.bytes_max = usable_memory_bytes() / 2;
  daemon.limits.request_bytes_max = daemon.admission.bytes_max;
  daemon.cache_bytes_max = std::min<uint64_t>(daemon.cache_bytes_max, usable_memory_bytes() / 8);
  daemon.smoothing_cache_bytes_max = std::min<uint64_t>(daemon.smoothing_cache_bytes_max, usable_memory_bytes() / 32);
  daemon.limits.transport_bytes_max = std::min<uint64_t>(daemon.limits.transport_bytes_max, usable_memory_bytes() / 4);
  config.receive_idle_ms = static_cast<uint32_t>(daemon.limits.receive_idle_max.count());
  return config;
}

// The command line over what `config` holds.
std::optional<ParsedConfig> parse_line(int argc, char** argv, Config& config, CommandLine& line) {
  const auto app = make_app(config);
  add_commands(*app, config, line);
  try {
    app->parse(argc, argv);
    return std::nullopt;
  } catch (const CLI::ParseError& e) {
    return ParsedConfig{std::nullopt, app->exit(e) == 0 ? 0 : kExitUsage};
  }
}

}  // namespace

ParsedConfig parse_config(int argc, char** argv) {
  CommandLine line;
  {
    // First by itself: for help, for the file's name, and so that its errors are not those of another source.
    Config alone = defaults();
    if (std::optional<ParsedConfig> ended = parse_line(argc, argv, alone, line)) return *ended;
  }
  if (const char* const file = std::getenv("BARYCASTD_CONFIG"); line.file.empty() && file != nullptr) line.file = file;
  Config config = defaults();
  if (!line.file.empty() && !read_file(line.file, config)) return {std::nullopt, kExitUsage};
  if (!read_environment(config)) return {std::nullopt, kExitUsage};
  if (std::optional<ParsedConfig> ended = parse_line(argc, argv, config, line)) return *ended;
  config.daemon.limits.receive_idle_max = std::chrono::milliseconds(config.receive_idle_ms);
  return {config, 0};
}

}  // namespace barycast::server
