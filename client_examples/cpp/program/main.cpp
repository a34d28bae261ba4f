// barycast_bind: binds a model to a cage and writes BIND.npz. Exit codes: 0 done, 2 usage, 3 input (a file,
// a cage, an option), 4 server, 130 Ctrl-C, 143 terminated. Errors are one sentence on standard error.

#include <signal.h>

#include <atomic>
#include <cstdio>
#include <ctime>
#include <optional>
#include <thread>

#include "arguments.h"
#include "barycast/client/client.h"
#include "barycast/client/local_server.h"
#include "obj.h"
#include "report.h"

namespace barycast::program {
namespace {

using client::Error;
using client::Result;

// A private server on this machine that goes away does not come back.
constexpr std::chrono::milliseconds kPrivateRetryMax{2000};

// Turns SIGINT and SIGTERM into a stop request, so that a private server and its folder go too. Made before any other
// thread: threads inherit the mask.
class Signals {
 public:
  Signals() {
    sigemptyset(&signals_);
    sigaddset(&signals_, SIGINT);
    sigaddset(&signals_, SIGTERM);
    pthread_sigmask(SIG_BLOCK, &signals_, nullptr);
    waiter_ = std::jthread([this](const std::stop_token& done) { wait(done); });
  }

  std::stop_token stop() const { return source_.get_token(); }
  int received() const { return received_; }

 private:
  void wait(const std::stop_token& done) {
    const timespec tick{.tv_sec = 0, .tv_nsec = 50'000'000};
    while (!done.stop_requested()) {
      const int signal = sigtimedwait(&signals_, nullptr, &tick);
      if (signal <= 0) continue;
      received_ = signal;
      source_.request_stop();
    }
  }

  sigset_t signals_{};
  std::stop_source source_;
  std::atomic<int> received_{0};
  std::jthread waiter_;
};

Result<client::Binding> bind_model(const Arguments& arguments, const std::stop_token& stop) {
  if (client::Status s = client::check_output(arguments.output, {arguments.cage, arguments.model}); !s) {
    return s.error();
  }
  if (arguments.server) {
    if (client::Status s = client::check_address(*arguments.server); !s) return s.error();
  }
  const Result<Model> cage_file = read_obj(arguments.cage);
  if (!cage_file) return cage_file.error();
  const Result<client::Cage> cage = to_cage(*cage_file);
  if (!cage) return cage.error();
  const Result<Model> model = read_obj(arguments.model);
  if (!model) return model.error();
  const Result<std::vector<double>> points = points_for(*model, cage->dimension());
  if (!points) return points.error();

  client::ClientSettings settings{.address = arguments.server.value_or("")};
  settings.retry_time_max = std::chrono::milliseconds(static_cast<int64_t>(1000 * arguments.retry_s));
  std::unique_ptr<client::LocalServer> local;
  if (!arguments.server) {
    const Result<std::string> program = client::find_daemon();
    if (!program) return program.error();
    Result<std::unique_ptr<client::LocalServer>> started = client::LocalServer::start({.program = *program}, stop);
    if (!started) return started.error();
    local = std::move(*started);
    settings.address = local->address();
    settings.retry_time_max = kPrivateRetryMax;
  }
  client::Client client(settings);
  const WaitingLine waiting(client, arguments);
  ProgressBar bar(arguments.quiet);
  Result<client::Binding> binding = client.bind(
      *cage, {std::span<const double>(*points), cage->dimension()}, model->faces, arguments.options,
      [&](const client::Progress& progress) { bar.show(progress); }, stop);
  if (!binding) return binding;
  if (client::Status s = client::save(*binding, arguments.output); !s) return s.error();
  return binding;
}

int run(const Arguments& arguments) {
  const Signals signals;
  const Result<client::Binding> binding = bind_model(arguments, signals.stop());
  if (binding) {
    if (!arguments.quiet) std::fputs(summary(*binding).c_str(), stdout);
    return kDone;
  }
  if (signals.received() != 0) {
    std::fputs(signals.received() == SIGINT ? "barycast_bind: interrupted\n" : "barycast_bind: terminated\n", stderr);
    return signals.received() == SIGINT ? kInterrupted : kTerminated;
  }
  const Error& error = binding.error();
  std::fprintf(stderr, "barycast_bind: %s\n", error.text().c_str());
  return error.is_input ? kInput : kServer;
}

}  // namespace
}  // namespace barycast::program

int main(int argc, char** argv) {
  const barycast::program::ParsedArguments parsed = barycast::program::parse_arguments(argc, argv);
  return parsed.arguments ? barycast::program::run(*parsed.arguments) : parsed.exit_code;
}
