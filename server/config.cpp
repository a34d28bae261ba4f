#include "config.h"

#include <CLI/CLI.hpp>

#include "machine.h"

namespace barycast::server {

ParsedConfig parse_config(int argc, char** argv) {
  Config config;
  DaemonSettings& daemon = config.daemon;
  Limits& limits = daemon.limits;
  // Half the memory for working requests; the rest for the cache, blocks on their way, and the system.
  daemon.admission.bytes_max = usable_memory_bytes() / 2;
  limits.request_bytes_max = daemon.admission.bytes_max;
  daemon.cache_bytes_max = std::min<uint64_t>(daemon.cache_bytes_max, usable_memory_bytes() / 8);

  auto receive_idle_ms = static_cast<uint32_t>(limits.receive_idle_max.count());

  CLI::App app("barycastd: computes generalized barycentric coordinates, over gRPC");
  app.set_version_flag("--version", "barycastd " BARYCAST_VERSION);
  app.option_defaults()->always_capture_default();
  app.add_option("--listen", daemon.listen,
                 "HOST:PORT (port 0: any free one) or unix:/path; loopback unless told otherwise");
  app.add_option("--port-file", config.port_file, "File that receives the bound address once the server is ready");
  app.add_option("--threads", daemon.threads, "Compute threads; 0: the CPUs that affinity and cgroup quota allow")
      ->check(CLI::Range(0, 1024));
  app.add_option("--drain-seconds", config.drain_s, "How long running calls may go on after SIGTERM");
  app.add_option("--log-level", config.log_level, "Of the log on stderr")
      ->check(CLI::IsMember({"trace", "debug", "info", "warn", "warning", "error", "critical", "off"}));
  app.add_flag("--exit-on-stdin-close", config.exit_on_stdin_close, "Stop when standard input is closed");
  app.add_option("--probe", config.probe, "Ask the server at this address for its health; exit code 0: it serves");

  const CLI::AsSizeValue as_bytes(false);
  app.add_option("--cache-bytes", daemon.cache_bytes_max, "Cages kept, in bytes")->transform(as_bytes)->group("Limits");
  app.add_option("--requests-max", daemon.admission.requests_max, "Requests at work at once")
      ->check(CLI::PositiveNumber)
      ->group("Limits");
  app.add_option("--admitted-bytes-max", daemon.admission.bytes_max, "Estimated memory of all requests at work")
      ->transform(as_bytes)
      ->group("Limits");
  app.add_option("--request-bytes-max", limits.request_bytes_max, "Estimated memory of one request")
      ->transform(as_bytes)
      ->group("Limits");
  app.add_option("--cage-bytes-max", limits.cage_bytes_max, "Canonical bytes of one cage")
      ->transform(as_bytes)
      ->group("Limits");
  app.add_option("--message-bytes-max", limits.message_bytes_max, "One message from a client")
      ->transform(as_bytes)
      ->check(CLI::Range(uint64_t{1024}, uint64_t{1} << 30))
      ->group("Limits");
  app.add_option("--transport-bytes-max", limits.transport_bytes_max, "Messages on their way, of all calls")
      ->transform(as_bytes)
      ->group("Limits");
  app.add_option("--receive-idle-ms", receive_idle_ms, "Longest silence of a client that is still sending")
      ->check(CLI::Range(uint32_t{100}, uint32_t{86'400'000}))
      ->group("Limits");
  app.add_option("--points-max", limits.points_max, "Query points of one request")->group("Limits");
  app.add_option("--faces-max", limits.faces_max, "Faces of one request")->group("Limits");
  app.add_option("--samples-max", limits.samples_max, "Samples per query point")
      ->check(CLI::PositiveNumber)
      ->group("Limits");
  app.add_option("--block-rows-max", limits.block_rows_max, "Rows per block")
      ->check(CLI::PositiveNumber)
      ->group("Limits");
  app.add_option("--digests-max", limits.digests_max, "Digests of one FindMissingCages request")->group("Limits");

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return {std::nullopt, app.exit(e)};
  }
  limits.receive_idle_max = std::chrono::milliseconds(receive_idle_ms);
  return {config, 0};
}

}  // namespace barycast::server
