// The real program: its files, signals and exit codes. BARYCASTD is its path, given by the build.

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "client.h"
#include "messages.h"

namespace barycast::server {
namespace {

using namespace testing;
namespace fs = std::filesystem;

// A child process with a pipe as its standard input.
class Process {
 public:
  explicit Process(std::vector<std::string> arguments) {
    int ends[2];
    EXPECT_EQ(pipe2(ends, O_CLOEXEC), 0);
    arguments.insert(arguments.begin(), BARYCASTD);
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    pid_ = fork();
    if (pid_ == 0) {
      dup2(ends[0], STDIN_FILENO);
      execv(BARYCASTD, argv.data());
      _exit(127);
    }
    close(ends[0]);
    stdin_ = ends[1];
  }
  ~Process() {
    close_stdin();
    if (!ended_) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  void close_stdin() {
    if (stdin_ >= 0) close(stdin_);
    stdin_ = -1;
  }
  void signal(int number) const { kill(pid_, number); }
  bool ended() {
    if (!ended_) ended_ = waitpid(pid_, &status_, WNOHANG) == pid_;
    return ended_;
  }
  // -1: it goes on, or was killed.
  int exit_code() {
    if (!eventually([this] { return ended(); }, std::chrono::seconds(40)) || !WIFEXITED(status_)) return -1;
    return WEXITSTATUS(status_);
  }

 private:
  pid_t pid_ = -1;
  int stdin_ = -1;
  int status_ = 0;
  bool ended_ = false;
};

class DaemonTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "barycastd_XXXXXX").string();
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    folder_ = pattern;
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string port_file() const { return (folder_ / "port").string(); }
  // The address once the server is ready; empty if it never is.
  std::string address() const {
    std::string result;
    eventually([&] {
      std::ifstream in(port_file());
      return static_cast<bool>(std::getline(in, result));
    });
    return result;
  }

  fs::path folder_;
};

TEST_F(DaemonTest, ServesProbesAndStops) {
  Process daemon({"--listen", "127.0.0.1:0", "--port-file", port_file(), "--threads", "2"});
  const std::string where = address();
  ASSERT_FALSE(where.empty());
  EXPECT_EQ(Process({"--probe", where}).exit_code(), 0);
  const Answer answer = Client(where).compute({header(1), points({0.1, 0.2, 0.3})});
  EXPECT_EQ(answer.code, kOk) << answer.message;
  // A second one on the same port must say so instead of sharing its calls.
  EXPECT_EQ(Process({"--listen", where}).exit_code(), 1);
  daemon.signal(SIGTERM);
  EXPECT_EQ(daemon.exit_code(), 0);
  EXPECT_FALSE(fs::exists(port_file()));
  EXPECT_EQ(Process({"--probe", where}).exit_code(), 1);
}

TEST_F(DaemonTest, ListensOnAUnixSocket) {
  const std::string socket = "unix:" + (folder_ / "socket").string();
  Process daemon({"--listen", socket, "--port-file", port_file()});
  ASSERT_EQ(address(), socket);
  EXPECT_EQ(Process({"--probe", socket}).exit_code(), 0);
  EXPECT_EQ(Client(socket).compute({header(1), points({0.1, 0.2, 0.3})}).code, kOk);
  daemon.signal(SIGINT);
  EXPECT_EQ(daemon.exit_code(), 0);
}

TEST_F(DaemonTest, DrainsOnSigterm) {
  Process daemon({"--listen", "127.0.0.1:0", "--port-file", port_file(), "--drain-seconds", "300"});
  const std::string where = address();
  ASSERT_FALSE(where.empty());
  Client client(where);
  // A call that has begun and not ended when the signal comes.
  const auto stream = client.open();
  auto head = header(1000);
  head.mutable_header()->mutable_options()->set_samples(100);
  stream->write(head);
  stream->write(points(inner_points(1000)));
  stream->half_close();
  v1::ComputeCoordinatesResponse response;
  ASSERT_TRUE(stream->read(response));
  daemon.signal(SIGTERM);
  EXPECT_EQ(stream->finish().code, kOk);
  EXPECT_EQ(daemon.exit_code(), 0);
}

TEST_F(DaemonTest, DrainEnds) {
  Process daemon({"--listen", "127.0.0.1:0", "--port-file", port_file(), "--drain-seconds", "1"});
  const std::string where = address();
  ASSERT_FALSE(where.empty());
  Client client(where);
  const auto stream = client.open();
  stream->write(header(1));  // and never its point
  daemon.signal(SIGTERM);
  EXPECT_EQ(daemon.exit_code(), 0);
  EXPECT_NE(stream->finish().code, kOk);
}

TEST_F(DaemonTest, EndsWithItsOwner) {
  Process daemon({"--listen", "127.0.0.1:0", "--port-file", port_file(), "--exit-on-stdin-close"});
  ASSERT_FALSE(address().empty());
  EXPECT_FALSE(daemon.ended());
  daemon.close_stdin();
  EXPECT_EQ(daemon.exit_code(), 0);
}

TEST_F(DaemonTest, ExitCodesOfTheCommandLine) {
  EXPECT_EQ(Process({"--version"}).exit_code(), 0);
  EXPECT_EQ(Process({"--help"}).exit_code(), 0);
  EXPECT_EQ(Process({"--no-such-flag"}).exit_code(), 2);
  EXPECT_EQ(Process({"--listen", "no.such.host.invalid:1"}).exit_code(), 1);
  EXPECT_EQ(Process({"--probe", "127.0.0.1:1"}).exit_code(), 1);
  EXPECT_EQ(Process({"--listen", "127.0.0.1:0", "--port-file", "/no/such/folder/port"}).exit_code(), 1);
}

}  // namespace
}  // namespace barycast::server
