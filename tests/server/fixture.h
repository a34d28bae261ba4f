#pragma once

// A server in this process on a free port, and a client of it.

#include <gtest/gtest.h>

#include "client.h"
#include "daemon.h"
#include "messages.h"

namespace barycast::server::testing {

class ServerTest : public ::testing::Test {
 protected:
  void SetUp() override { start({}); }

  void start(DaemonSettings settings) {
    client_.reset();
    daemon_.reset();
    settings.listen = "127.0.0.1:0";
    Result<std::unique_ptr<Daemon>> started = Daemon::start(settings);
    ASSERT_TRUE(started.ok()) << started.error().text();
    daemon_ = std::move(*started);
    client_ = std::make_unique<Client>(daemon_->address());
  }

  const Counters& counters() const { return daemon_->counters(); }
  // A request whose answer is known, to see that the server is well.
  void expect_works() {
    const Answer answer =
        client_->compute({header(1), points({0.1, 0.2, 0.3})}, {.deadline = std::chrono::seconds(20), .metadata = {}});
    ASSERT_EQ(answer.code, kOk) << answer.message;
    ASSERT_EQ(answer.rows.size(), 1u);
    const std::vector<double> values = numbers<double>(answer.rows[0].values());
    ASSERT_EQ(values.size(), 4u);
    EXPECT_NEAR(values[0], 0.4, 1e-11);
    EXPECT_NEAR(values[3], 0.3, 1e-11);
  }

  std::unique_ptr<Daemon> daemon_;
  std::unique_ptr<Client> client_;
};

}  // namespace barycast::server::testing
