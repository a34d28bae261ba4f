#include "cage_cache.h"

#include "base/guarded_build.h"

namespace barycast::server {

CageCache::Found CageCache::get(const CageDigest& digest, const Build& build, Waiter waiter) {
  Index held;
  {
    const std::lock_guard lock(mutex_);
    held = held_.find(digest);
    if (!held) {
      const auto [building, first] = building_.try_emplace(digest);
      building->second.push_back(std::move(waiter));
      ++(first ? stats_.misses : stats_.joins);
      if (!first) return Found::kJoined;
    } else {
      ++stats_.hits;
    }
  }
  if (held) {
    waiter(std::move(held), Found::kHit);
    return Found::kHit;
  }
  const Result<Index> built = guarded_build(build);
  std::vector<Waiter> waiters;
  std::vector<Index> evicted;  // destroyed outside the mutex
  {
    const std::lock_guard lock(mutex_);
    const auto building = building_.find(digest);
    waiters = std::move(building->second);
    building_.erase(building);
    if (built.ok()) held_.keep(digest, *built, (*built)->bytes(), evicted);
    stats_.evictions += evicted.size();
  }
  // The first to ask is the one that built.
  for (size_t i = 0; i < waiters.size(); ++i) waiters[i](built, i == 0 ? Found::kBuilt : Found::kJoined);
  return Found::kBuilt;
}

CageCache::Found CageCache::find(const CageDigest& digest, Waiter waiter) {
  Index held;
  {
    const std::lock_guard lock(mutex_);
    held = held_.find(digest);
    if (!held) {
      const auto building = building_.find(digest);
      const bool joined = building != building_.end();
      ++(joined ? stats_.joins : stats_.misses);
      if (!joined) return Found::kMissing;
      building->second.push_back(std::move(waiter));
      return Found::kJoined;
    }
    ++stats_.hits;
  }
  waiter(std::move(held), Found::kHit);
  return Found::kHit;
}

bool CageCache::contains(const CageDigest& digest) {
  const std::lock_guard lock(mutex_);
  return held_.find(digest) != nullptr;
}

void CageCache::recount(const CageIndex& index) {
  std::vector<Index> evicted;  // destroyed outside the mutex
  const std::lock_guard lock(mutex_);
  if (held_.find(index.digest()).get() != &index) return;  // evicted since, or built again
  held_.resize(index.digest(), index.bytes(), evicted);
  stats_.evictions += evicted.size();
}

uint64_t CageCache::bytes() const {
  const std::lock_guard lock(mutex_);
  return held_.bytes();
}

CageCache::Stats CageCache::stats() const {
  const std::lock_guard lock(mutex_);
  return stats_;
}

size_t CageCache::entry_count() const {
  const std::lock_guard lock(mutex_);
  return held_.size();
}

}  // namespace barycast::server
