#pragma once

// What this process may use of the machine: the container's share, not the host's size. Reads cgroup
// files (v1 and v2) once at start; what cannot be read does not limit.

#include <cstdint>
#include <filesystem>

namespace barycast::server {

// Threads worth running: the CPUs of the affinity mask (which follows the cpuset), at most the cgroup's
// CPU quota rounded up. 1 or more. `root` is where /proc and /sys are looked for.
int usable_threads(const std::filesystem::path& root = "/");

// Bytes of memory: physical memory, at most the cgroup's limit.
uint64_t usable_memory_bytes(const std::filesystem::path& root = "/");

}  // namespace barycast::server
