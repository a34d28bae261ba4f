#include "machine.h"

#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <vector>

namespace barycast::server {
namespace {

using std::filesystem::path;

// A number, or nothing for "max", -1 and files that are not there.
std::optional<double> read_number(std::istream& in) {
  double value;
  if (!(in >> value) || value < 0) return std::nullopt;
  return value;
}

std::optional<double> read_number(const path& file) {
  std::ifstream in(file);
  return read_number(in);
}

// The folders that may hold this process's limits for a v1 controller ("cpu", "memory") or for v2 (""):
// its own cgroup and every ancestor, since the tightest limit counts. In a container the path may be
// the host's, of which only the root is mounted; then the root answers.
std::vector<path> cgroup_folders(const path& root, const std::string& controller) {
  std::vector<path> folders;
  std::ifstream in(root / "proc/self/cgroup");
  for (std::string line; std::getline(in, line);) {
    const size_t first = line.find(':');
    const size_t second = line.find(':', first + 1);
    if (first == std::string::npos || second == std::string::npos) continue;
    const std::string names = line.substr(first + 1, second - first - 1);
    const bool v2 = names.empty();
    if (v2 != controller.empty() || (!v2 && ("," + names + ",").find("," + controller + ",") == std::string::npos)) {
      continue;
    }
    for (const std::string& mount :
         v2 ? std::vector<std::string>{"", "unified"} : std::vector<std::string>{controller, names}) {
      const path base = root / "sys/fs/cgroup" / mount;
      for (path below = path(line.substr(second + 1)).relative_path();; below = below.parent_path()) {
        folders.push_back(base / below);
        if (below.empty()) break;
      }
    }
  }
  return folders;
}

double tightest(const std::vector<path>& folders, const std::function<std::optional<double>(const path&)>& read) {
  double least = std::numeric_limits<double>::infinity();
  for (const path& folder : folders) least = std::min(least, read(folder).value_or(least));
  return least;
}

std::optional<double> cpus_v2(const path& folder) {
  std::ifstream in(folder / "cpu.max");  // "QUOTA PERIOD" in microseconds
  const std::optional<double> quota = read_number(in);
  const std::optional<double> period = quota ? read_number(in) : std::nullopt;
  if (!period || *period == 0) return std::nullopt;
  return *quota / *period;
}

std::optional<double> cpus_v1(const path& folder) {
  const std::optional<double> quota = read_number(folder / "cpu.cfs_quota_us");
  const std::optional<double> period = read_number(folder / "cpu.cfs_period_us");
  if (!quota || !period || *period == 0) return std::nullopt;
  return *quota / *period;
}

}  // namespace

int usable_threads(const path& root) {
  cpu_set_t mask;
  CPU_ZERO(&mask);
  const bool known = sched_getaffinity(0, sizeof mask, &mask) == 0;
  // Beyond 1024 CPUs the fixed mask is too small and the call fails.
  const double cpus = known ? CPU_COUNT(&mask) : static_cast<double>(sysconf(_SC_NPROCESSORS_ONLN));
  const double quota =
      std::min(tightest(cgroup_folders(root, ""), cpus_v2), tightest(cgroup_folders(root, "cpu"), cpus_v1));
  // Half a CPU of quota is worth a thread: the kernel throttles it, it does not refuse it.
  return std::max(1, static_cast<int>(std::min(cpus, std::ceil(quota))));
}

uint64_t usable_memory_bytes(const path& root) {
  const double physical = static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGE_SIZE));
  const double v2 = tightest(cgroup_folders(root, ""), [](const path& f) { return read_number(f / "memory.max"); });
  const double v1 =
      tightest(cgroup_folders(root, "memory"), [](const path& f) { return read_number(f / "memory.limit_in_bytes"); });
  return static_cast<uint64_t>(std::min({physical, v1, v2}));
}

}  // namespace barycast::server
