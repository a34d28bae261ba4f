#include "settings.h"

#include <CLI/CLI.hpp>

namespace barycast::server {
namespace {

void add_limits(CLI::App& app, DaemonSettings& daemon) {
  Limits& limits = daemon.limits;
  // A number of bytes, or with a unit: 2GB and 2GiB are 2^31.
  const CLI::AsSizeValue as_bytes(false);
  const auto bytes = [&](const char* name, uint64_t& value, const char* help) {
    return app.add_option(name, value, help)->transform(as_bytes)->group("Limits");
  };
  bytes("--cache-bytes", daemon.cache_bytes_max, "Cages kept, in bytes");
  bytes("--smoothing-cache-bytes", daemon.smoothing_cache_bytes_max, "Factors of denoising kept, in bytes");
  app.add_option("--requests-max", daemon.admission.requests_max, "Requests at work at once")
      ->check(CLI::PositiveNumber)
      ->group("Limits");
  bytes("--admitted-bytes-max", daemon.admission.bytes_max, "Estimated memory of all requests at work");
  bytes("--request-bytes-max", limits.request_bytes_max, "Estimated memory of one request");
  bytes("--cage-bytes-max", limits.cage_bytes_max, "Canonical bytes of one cage");
  bytes("--message-bytes-max", limits.message_bytes_max, "One message from a client")
      ->check(CLI::Range(uint64_t{1024}, uint64_t{1} << 30));
  bytes("--transport-bytes-max", limits.transport_bytes_max, "Messages on their way, of all calls");
  app.add_option("--points-max", limits.points_max, "Query points of one request")->group("Limits");
  app.add_option("--faces-max", limits.faces_max, "Faces of one request")->group("Limits");
  app.add_option("--samples-max", limits.samples_max, "Samples per query point")
      ->check(CLI::PositiveNumber)
      ->group("Limits");
  app.add_option("--block-rows-max", limits.block_rows_max, "Rows per block")
      ->check(CLI::PositiveNumber)
      ->group("Limits");
  app.add_option("--digests-max", limits.digests_max, "Digests of one FindMissingCages request")->group("Limits");
}

// gRPC would take a missing port for 443, and a large one modulo 65536. Empty: right.
std::string check_host_port(const std::string& address) {
  const size_t colon = address.rfind(':');
  const std::string port = colon == std::string::npos ? "" : address.substr(colon + 1);
  const bool number = !port.empty() && port.size() <= 5 && port.find_first_not_of("0123456789") == std::string::npos;
  if (colon != 0 && number && std::stoul(port) <= 65535) return {};
  return "must be HOST:PORT with a port from 0 to 65535, not \"" + address + "\"";
}

std::string check_listen(const std::string& address) {
  return address.starts_with("unix:") ? "" : check_host_port(address);
}

}  // namespace

std::unique_ptr<CLI::App> make_app(Config& config) {
  auto made = std::make_unique<CLI::App>("barycastd: computes generalized barycentric coordinates, over gRPC");
  CLI::App& app = *made;
  DaemonSettings& daemon = config.daemon;
  app.option_defaults()->always_capture_default();
  app.footer(
      "Every setting may also come from the environment (--cache-bytes: BARYCASTD_CACHE_BYTES) or from the\n"
      "file of --config (cache-bytes = \"2GB\"); flags win over the environment, and that over the file.");
  app.add_option("--listen", daemon.listen,
                 "HOST:PORT (port 0: any free one) or unix:/path; loopback unless told otherwise")
      ->check(check_listen);
  app.add_option("--port-file", config.port_file, "File that receives the bound address once the server is ready");
  app.add_option("--metrics-listen", daemon.metrics_listen,
                 "HOST:PORT of the Prometheus page /metrics; off unless given")
      ->check(check_host_port);
  app.add_option("--metrics-port-file", config.metrics_port_file, "File that receives the metrics page's address");
  app.add_option("--threads", daemon.threads, "Compute threads; 0: the CPUs that affinity and cgroup quota allow")
      ->check(CLI::Range(0, 1024));
  app.add_option("--drain-seconds", config.drain_s, "How long running calls may go on after SIGTERM");
  app.add_option("--log-level", config.log_level, "Of the log on stderr")
      ->check(CLI::IsMember({"trace", "debug", "info", "warn", "warning", "error", "critical", "off"}));
  app.add_option("--log-format", config.log_format, "Of the log on stderr: for people, or a JSON object per line")
      ->check(CLI::IsMember({"text", "json"}));
  app.add_flag("--exit-on-stdin-close", config.exit_on_stdin_close, "Stop when standard input is closed");
  app.add_option("--receive-idle-ms", config.receive_idle_ms, "Longest silence of a client that is still sending")
      ->check(CLI::Range(uint32_t{100}, uint32_t{86'400'000}))
      ->group("Limits");
  add_limits(app, daemon);
  return made;
}

std::vector<std::string> setting_keys() {
  Config ignored;
  std::vector<std::string> result;
  const auto app = make_app(ignored);
  for (const CLI::Option* option : app->get_options())
    if (option->get_configurable() && !option->get_lnames().empty() && option->get_lnames()[0] != "help")
      result.push_back(option->get_lnames()[0]);
  return result;
}

std::string config_text(Config config) {
  std::string text;
  const auto app = make_app(config);
  for (const std::string& key : setting_keys()) {
    const CLI::Option* const option = app->get_option("--" + key);
    // A flag has no captured default.
    const bool is_flag = key == "exit-on-stdin-close";
    std::string value = !is_flag ? option->get_default_str() : config.exit_on_stdin_close ? "true" : "false";
    const bool is_number = !value.empty() && value.find_first_not_of("0123456789") == std::string::npos;
    if (value.find('"') != std::string::npos && value.find('\'') != std::string::npos) {
      text += "# " + key + ": holds quotes of both kinds, which no line of a file can\n";
      continue;
    }
    // A TOML literal takes everything but an apostrophe.
    if (!is_flag && !is_number) value = value.find('"') == std::string::npos ? '"' + value + '"' : "'" + value + "'";
    text += key + " = " + value + "\n";
  }
  return text;
}

}  // namespace barycast::server
