// CPU and memory limits as cgroups state them, from files made up here.

#include "machine.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

namespace barycast::server {
namespace {

namespace fs = std::filesystem;

class Machine : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "barycast_machine_XXXXXX").string();
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    root_ = pattern;
  }
  void TearDown() override { fs::remove_all(root_); }

  void write(const std::string& path, const std::string& text) {
    fs::create_directories((root_ / path).parent_path());
    std::ofstream(root_ / path) << text;
  }

  fs::path root_;
};

TEST_F(Machine, NoCgroupDoesNotLimit) {
  EXPECT_EQ(usable_threads(root_), usable_threads("/nonexistent"));
  EXPECT_GE(usable_threads(root_), 1);
  EXPECT_GT(usable_memory_bytes(root_), 1u << 20);
}

TEST_F(Machine, QuotaOfVersion2) {
  write("proc/self/cgroup", "0::/pod/task\n");
  write("sys/fs/cgroup/pod/task/cpu.max", "max 100000\n");
  write("sys/fs/cgroup/pod/cpu.max", "50000 100000\n");
  EXPECT_EQ(usable_threads(root_), 1);
  write("sys/fs/cgroup/pod/task/memory.max", "max\n");
  write("sys/fs/cgroup/pod/memory.max", "1048576\n");
  EXPECT_EQ(usable_memory_bytes(root_), 1048576u);
}

TEST_F(Machine, QuotaOfVersion1) {
  write("proc/self/cgroup", "4:memory:/a\n3:cpu,cpuacct:/a\n0::/\n");
  write("sys/fs/cgroup/cpu,cpuacct/a/cpu.cfs_quota_us", "-1\n");
  write("sys/fs/cgroup/cpu,cpuacct/a/cpu.cfs_period_us", "100000\n");
  const int unlimited = usable_threads(root_);
  write("sys/fs/cgroup/cpu,cpuacct/a/cpu.cfs_quota_us", "90000\n");
  EXPECT_EQ(usable_threads(root_), 1);
  EXPECT_GE(unlimited, 1);
  write("sys/fs/cgroup/memory/a/memory.limit_in_bytes", "2097152\n");
  EXPECT_EQ(usable_memory_bytes(root_), 2097152u);
}

// In a container the path is the host's, and only the root is mounted.
TEST_F(Machine, FallsBackToTheRoot) {
  write("proc/self/cgroup", "0::/kubepods/burstable/x\n");
  write("sys/fs/cgroup/cpu.max", "100000 100000\n");
  EXPECT_EQ(usable_threads(root_), 1);
}

TEST_F(Machine, IgnoresWhatItCannotRead) {
  write("proc/self/cgroup", "nonsense\n0::/x\n");
  write("sys/fs/cgroup/x/cpu.max", "nonsense");
  EXPECT_EQ(usable_threads(root_), usable_threads("/nonexistent"));
}

}  // namespace
}  // namespace barycast::server
