#include "barycast/client/local_server.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <vector>

#include "retry.h"

extern char** environ;

namespace barycast::client {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds kPoll{5}, kStopMax{5000};
constexpr size_t kSocketPathBytesMax = 100;  // sun_path holds 108 on Linux

bool is_program(const fs::path& path) {
  std::error_code failure;
  return fs::is_regular_file(path, failure) && access(path.c_str(), X_OK) == 0;
}

fs::path in_path(const std::string& name) {
  const char* path = getenv("PATH");
  std::string_view folders = path != nullptr ? path : "";
  while (!folders.empty()) {
    const size_t end = std::min(folders.find(':'), folders.size());
    const fs::path candidate = fs::path(folders.substr(0, end)) / name;
    if (end > 0 && is_program(candidate)) return candidate;
    folders.remove_prefix(std::min(end + 1, folders.size()));
  }
  return {};
}

// A folder that only this user can enter, short enough for a socket's path; or empty.
std::string fresh_folder() {
  const char* named = getenv("TMPDIR");
  for (const std::string parent : {named != nullptr && *named != '\0' ? named : "/tmp", "/tmp"}) {
    std::string folder = parent + "/barycast-XXXXXX";
    if (folder.size() + std::strlen("/socket") > kSocketPathBytesMax) continue;
    if (mkdtemp(folder.data()) != nullptr) return folder;
  }
  return {};
}

Error server_error(std::string message, Code code = Code::kInternal) {
  return {.code = code, .field = "", .message = std::move(message)};
}

class Daemon final : public LocalServer {
 public:
  explicit Daemon(std::string folder) : folder_(std::move(folder)), address_("unix:" + folder_ + "/socket") {}

  ~Daemon() override {
    stop();
    if (input_ >= 0) close(input_);
    std::error_code ignored;
    fs::remove_all(folder_, ignored);
  }

  const std::string& address() const override { return address_; }

  Status spawn(const LocalServerSettings& settings) {
    std::vector<std::string> arguments = {settings.program,        "--listen",    address_, "--port-file", port_file(),
                                          "--exit-on-stdin-close", "--log-level", "error"};
    if (settings.threads > 0) arguments.insert(arguments.end(), {"--threads", std::to_string(settings.threads)});
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);

    std::array<int, 2> pipe_ends{};
    if (pipe2(pipe_ends.data(), O_CLOEXEC) != 0) return server_error(std::strerror(errno));
    posix_spawn_file_actions_t files;
    posix_spawn_file_actions_init(&files);
    posix_spawn_file_actions_adddup2(&files, pipe_ends[0], STDIN_FILENO);
    posix_spawn_file_actions_addopen(&files, STDOUT_FILENO, log_file().c_str(), O_WRONLY | O_CREAT | O_APPEND, 0600);
    posix_spawn_file_actions_adddup2(&files, STDOUT_FILENO, STDERR_FILENO);
    posix_spawnattr_t attributes;
    posix_spawnattr_init(&attributes);
    // Its own session: Ctrl-C at a terminal reaches us only, and we end it. Signals as at a program's start,
    // whatever this process blocks.
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSID | POSIX_SPAWN_SETSIGMASK);
    sigset_t none;
    sigemptyset(&none);
    posix_spawnattr_setsigmask(&attributes, &none);
    const int failure = posix_spawn(&process_, settings.program.c_str(), &files, &attributes, argv.data(), environ);
    posix_spawnattr_destroy(&attributes);
    posix_spawn_file_actions_destroy(&files);
    close(pipe_ends[0]);
    input_ = pipe_ends[1];
    if (failure == 0) return Done{};
    process_ = -1;
    return input_error(settings.program, std::string("cannot be started: ") + std::strerror(failure));
  }

  // Until the daemon has written its port file, which it does once it serves.
  Status wait(milliseconds time_max, const std::stop_token& stop) {
    const Clock::time_point end = Clock::now() + time_max;
    while (Clock::now() < end) {
      if (access(port_file().c_str(), F_OK) == 0) return Done{};
      if (ended()) return server_error("barycastd ended at start with " + how_it_ended() + last_words());
      if (!sleep_for(kPoll, stop)) return server_error("cancelled by the caller", Code::kCancelled);
    }
    return server_error("barycastd did not serve within " + std::to_string(time_max.count()) + " ms" + last_words(),
                        Code::kDeadlineExceeded);
  }

 private:
  std::string port_file() const { return folder_ + "/port"; }
  std::string log_file() const { return folder_ + "/log"; }

  bool ended() {
    if (process_ <= 0) return true;
    if (waitpid(process_, &status_, WNOHANG) == 0) return false;
    process_ = -1;
    return true;
  }

  std::string how_it_ended() const {
    if (WIFSIGNALED(status_)) return "signal " + std::to_string(WTERMSIG(status_));
    return "status " + std::to_string(WEXITSTATUS(status_));
  }

  std::string last_words() const {
    std::string last;
    std::ifstream log(log_file());
    for (std::string line; std::getline(log, line);) {
      if (!line.empty()) last = line;
    }
    return last.empty() ? "" : ": " + last;
  }

  void stop() {
    if (ended()) return;
    kill(process_, SIGTERM);
    for (const auto end = Clock::now() + kStopMax; Clock::now() < end; sleep_for(kPoll, {})) {
      if (ended()) return;
    }
    kill(process_, SIGKILL);
    waitpid(process_, &status_, 0);
  }

  const std::string folder_;
  const std::string address_;
  pid_t process_ = -1;
  int status_ = 0;
  int input_ = -1;  // closing it ends the daemon
};

}  // namespace

Result<std::string> find_daemon() {
  if (const char* named = getenv("BARYCASTD"); named != nullptr && *named != '\0') {
    if (is_program(named)) return std::string(named);
    return input_error("BARYCASTD", std::string(named) + " is not a program; let it name the barycastd binary");
  }
  std::error_code failure;
  const fs::path beside = fs::read_symlink("/proc/self/exe", failure).parent_path() / "barycastd";
  if (!failure && is_program(beside)) return beside.string();
  if (const fs::path found = in_path("barycastd"); !found.empty()) return found.string();
  return input_error("server",
                     "there is no barycastd beside this program or in PATH: build it, name it in the environment "
                     "variable BARYCASTD, or give the address of a running server (--server HOST:PORT)");
}

Result<std::unique_ptr<LocalServer>> LocalServer::start(const LocalServerSettings& settings,
                                                        const std::stop_token& stop) {
  const std::string folder = fresh_folder();
  if (folder.empty()) return input_error("TMPDIR", std::string("no folder can be made there: ") + std::strerror(errno));
  auto daemon = std::make_unique<Daemon>(folder);
  if (Status s = daemon->spawn(settings); !s) return s.error();
  if (Status s = daemon->wait(settings.start_time_max, stop); !s) return s.error();
  return Result<std::unique_ptr<LocalServer>>(std::move(daemon));
}

}  // namespace barycast::client
