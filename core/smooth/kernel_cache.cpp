#include "smooth/kernel_cache.h"

namespace barycast {

Sha256Digest KernelCache::key(const QueryMesh& mesh, std::span<const double> times) {
  static_assert(sizeof(Vec<3>) == 3 * sizeof(double));
  Sha256 sha;
  const uint64_t sizes[] = {mesh.nodes.size(), mesh.face_offsets.size(), mesh.face_nodes.size(), times.size()};
  sha.add(std::span<const uint64_t>(sizes));
  sha.add(std::span<const Vec<3>>(mesh.nodes));
  sha.add(std::span<const uint32_t>(mesh.face_offsets));
  sha.add(std::span<const uint32_t>(mesh.face_nodes));
  sha.add(times);
  return sha.finish();
}

KernelCache::Kernel KernelCache::find(const Sha256Digest& key) {
  const std::scoped_lock lock(mutex_);
  Kernel kernel = kernels_.find(key);
  ++(kernel ? stats_.hits : stats_.misses);
  return kernel;
}

void KernelCache::keep(const Sha256Digest& key, Kernel kernel) {
  std::vector<Kernel> evicted;  // destroyed outside the mutex
  const std::scoped_lock lock(mutex_);
  const uint64_t bytes = kernel->bytes();
  kernels_.keep(key, std::move(kernel), bytes, evicted);
  stats_.evictions += evicted.size();
}

KernelCache::Stats KernelCache::stats() const {
  const std::scoped_lock lock(mutex_);
  Stats stats = stats_;
  stats.bytes = kernels_.bytes();
  stats.entries = kernels_.size();
  return stats;
}

}  // namespace barycast
