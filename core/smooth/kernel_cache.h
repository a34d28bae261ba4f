#pragma once

// Factored heat kernels by the mesh and the times that they are of: another request for the same points and options
// skips the factorization. A kernel is a function of its key, so that a hit cannot change a bit. Thread-safe; bounded
// by bytes, the least recently used make room. Two requests that come at once may both factor: the second is not kept.

#include <memory>
#include <mutex>

#include "base/bounded_lru.h"
#include "base/sha256.h"
#include "smooth/heat.h"

namespace barycast {

// A kernel, and what its mesh was found to be.
struct MeshKernel {
  HeatKernel kernel;
  size_t faces_skipped = 0;  // as in MeshLaplacian
  size_t nodes_without_area = 0;

  size_t bytes() const { return sizeof(*this) + kernel.bytes(); }
};

class KernelCache {
 public:
  using Kernel = std::shared_ptr<const MeshKernel>;
  explicit KernelCache(uint64_t bytes_max) : kernels_(bytes_max) {}

  // times: as HeatKernel::create takes them.
  static Sha256Digest key(const QueryMesh& mesh, std::span<const double> times);

  Kernel find(const Sha256Digest& key);  // null: not held
  void keep(const Sha256Digest& key, Kernel kernel);

  struct Stats {
    uint64_t hits = 0, misses = 0, evictions = 0;  // since the start
    uint64_t bytes = 0, entries = 0;               // now
  };
  Stats stats() const;

 private:
  mutable std::mutex mutex_;
  BoundedLru<Sha256Digest, Kernel> kernels_;
  Stats stats_;
};

}  // namespace barycast
