#pragma once

// Cages with their acceleration structures, by digest: an LRU bounded by bytes, with single-flight
// builds. However many requests ask for one cage at once, it is built once; those that wait leave a
// callback and block no thread. An entry lives on in the requests that use it after it is evicted.
//
// Thread-safe. A lookup costs a mutex and a map; builds and callbacks run outside the mutex.
// A failed build reaches everyone who waits for it and is not kept. A cage larger than the bound is
// served and not kept. Callers pass digests that the server computed itself, so nobody can poison an
// entry.

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include "base/bounded_lru.h"
#include "base/result.h"
#include "bind/cage_index.h"

namespace barycast::server {

class CageCache {
 public:
  using Index = std::shared_ptr<const CageIndex>;
  using Build = std::function<Result<Index>()>;
  // kHit: held. kJoined: another request builds it. kBuilt: built here and now, on this thread.
  enum class Found { kHit, kJoined, kBuilt, kMissing };
  // Called exactly once: before get() returns, or later on the thread of another request's build.
  using Waiter = std::function<void(Result<Index>, Found)>;

  explicit CageCache(uint64_t bytes_max) : held_(bytes_max) {}

  Found get(const CageDigest& digest, const Build& build, Waiter waiter);
  // Never builds; kMissing: the waiter is dropped uncalled.
  Found find(const CageDigest& digest, Waiter waiter);
  // Held now. Counts as a use: who asks is about to refer to it.
  bool contains(const CageDigest& digest);

  // Counts a cage's bytes again, after a computation made it build more; the least recently used make room.
  void recount(const CageIndex& index);

  uint64_t bytes() const;
  size_t entry_count() const;

  // Since the start. Lookups by `get` and `find`; `contains` is a question, not a lookup.
  struct Stats {
    uint64_t hits = 0, joins = 0, misses = 0, evictions = 0;
  };
  Stats stats() const;

 private:
  mutable std::mutex mutex_;
  Stats stats_;
  BoundedLru<CageDigest, Index> held_;
  std::map<CageDigest, std::vector<Waiter>> building_;
};

}  // namespace barycast::server
