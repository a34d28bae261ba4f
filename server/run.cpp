#include "run.h"

#include <fcntl.h>
#include <signal.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <ctime>
#include <thread>

#include "config.h"
#include "kinds.h"
#include "log.h"
#include "self_test.h"

namespace barycast::server {
namespace {

constexpr std::chrono::milliseconds kProbeTimeout{2000};
// After the drain: cancelled calls notice within tens of milliseconds.
constexpr std::chrono::milliseconds kStopGrace{200};

// Blocked in every thread, since threads inherit the mask; the main thread collects them.
sigset_t block_stop_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  // A reader of our log or socket that goes away is an error of a write, not our end.
  signal(SIGPIPE, SIG_IGN);
  return signals;
}

// Readers never see half an address: the name appears when the content is complete.
bool write_port_file(const std::string& path, const std::string& address) {
  const std::string partial = path + ".partial";
  std::FILE* file = std::fopen(partial.c_str(), "w");
  if (file == nullptr) return false;
  const bool written = std::fprintf(file, "%s\n", address.c_str()) > 0;
  const bool closed = std::fclose(file) == 0;
  return written && closed && std::rename(partial.c_str(), path.c_str()) == 0;
}

// Ends the process as SIGTERM would once the owner of our standard input is gone.
void watch_stdin() {
  std::thread([] {
    char byte[256];
    ssize_t got;
    do {
      got = read(STDIN_FILENO, byte, sizeof byte);
    } while (got > 0 || (got < 0 && errno == EINTR));
    spdlog::info("standard input was closed");
    kill(getpid(), SIGTERM);
  }).detach();
}

// Running calls go on until they are done, the time is up, or a second signal says that it is urgent.
void drain(Daemon& daemon, const sigset_t& signals, std::chrono::seconds time) {
  daemon.begin_drain();
  const auto end = std::chrono::steady_clock::now() + time;
  const timespec tick{.tv_sec = 0, .tv_nsec = 50'000'000};
  while (daemon.busy() && std::chrono::steady_clock::now() < end) {
    if (sigtimedwait(&signals, nullptr, &tick) > 0) break;
  }
  if (daemon.busy())
    spdlog::warn("{} calls are still running and are cancelled", daemon.counters().calls_active.load());
  daemon.stop(kStopGrace);
}

bool is_loopback(const std::string& address) {
  return address.starts_with("127.") || address.starts_with("localhost:") || address.starts_with("[::1]:") ||
         address.starts_with("unix:");
}

int run_self_test() {
  const Status tested = self_test();
  if (!tested) {
    std::fprintf(stderr, "barycastd: %s\n", tested.error().text().c_str());
    return 1;
  }
  std::string kinds;
  for (const CoordinateKind kind : built_kinds()) kinds += std::string(kinds.empty() ? "" : ", ") + kind_name(kind);
  std::printf("barycastd: the self-test passed for %s\n", kinds.c_str());
  return 0;
}

int print_config(const Config& config) {
  return std::fputs(config_text(config).c_str(), stdout) >= 0 && std::fflush(stdout) == 0 ? 0 : 1;
}

int run_probe(const std::string& address) {
  const Health health = probe(address, kProbeTimeout);
  if (health == Health::kNoAnswer) {
    std::fprintf(stderr, "barycastd: no server answers at %s\n", address.c_str());
  } else {
    std::puts(health == Health::kServing ? "SERVING" : "NOT_SERVING");
  }
  return health == Health::kServing ? 0 : 1;
}

int serve(const Config& config, const sigset_t& signals) {
  Result<std::unique_ptr<Daemon>> started = Daemon::start(config.daemon);
  if (!started) {
    spdlog::critical("{}", started.error().text());
    return 1;
  }
  Daemon& daemon = **started;
  if (!is_loopback(daemon.address())) spdlog::warn("listening beyond this machine, without encryption or login");
  spdlog::info("barycastd " BARYCAST_VERSION " serves on {}, {} compute threads", daemon.address(), daemon.threads());
  if (!daemon.metrics_address().empty()) spdlog::info("metrics on http://{}/metrics", daemon.metrics_address());
  if (!config.port_file.empty() && !write_port_file(config.port_file, daemon.address())) {
    spdlog::critical("cannot write {}", config.port_file);
    return 1;
  }
  if (!config.metrics_port_file.empty() && !write_port_file(config.metrics_port_file, daemon.metrics_address())) {
    spdlog::critical("cannot write {}", config.metrics_port_file);
    return 1;
  }
  if (config.exit_on_stdin_close) watch_stdin();
  int received = 0;
  sigwait(&signals, &received);
  spdlog::info("received {}; draining for up to {} s", received == SIGINT ? "SIGINT" : "SIGTERM", config.drain_s);
  drain(daemon, signals, std::chrono::seconds(config.drain_s));
  for (const std::string& file : {config.port_file, config.metrics_port_file})
    if (!file.empty()) unlink(file.c_str());
  spdlog::info("stopped");
  return 0;
}

}  // namespace

int run(int argc, char** argv) {
  const sigset_t signals = block_stop_signals();
  const ParsedConfig parsed = parse_config(argc, argv);
  if (!parsed.config) return parsed.exit_code;
  const Config& config = *parsed.config;
  if (config.print_config) return print_config(config);
  if (config.self_test) return run_self_test();
  // All of a host's addresses, 0.0.0.0, are its loopback to who connects.
  if (!config.probe.empty()) return run_probe(config.probe == kProbeListen ? config.daemon.listen : config.probe);
  init_log(config.log_format == "json" ? LogFormat::kJson : LogFormat::kText, config.log_level);
  return serve(config, signals);
}

}  // namespace barycast::server
