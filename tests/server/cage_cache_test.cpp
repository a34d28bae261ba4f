// The cache alone: order of eviction, bytes, single flight, failures.

#include "cage_cache.h"

#include <gtest/gtest.h>

#include <atomic>
#include <condition_variable>
#include <thread>

#include "decode.h"
#include "messages.h"

namespace barycast::server {
namespace {

using namespace testing;
using Found = CageCache::Found;

struct Sample {
  CageStorage storage;
  CageDigest digest;
  CageCache::Build build() const {
    return [this] { return CageIndex::create(storage.input()); };
  }
};

// Cages of one size in bytes, distinct by their scale.
Sample sample(int i) {
  Sample result{*decode_cage(tetrahedron(1.0 + i), {}), {}};
  result.digest = digest(result.storage.input());
  return result;
}

uint64_t bytes_of(const Sample& s) {
  return (*s.build()())->bytes();
}

Found put(CageCache& cache, const Sample& s) {
  return cache.get(s.digest, s.build(), [](const Result<CageCache::Index>& index, Found) { EXPECT_TRUE(index.ok()); });
}

TEST(CageCache, EvictsTheLeastRecentlyUsed) {
  const Sample a = sample(0), b = sample(1), c = sample(2);
  CageCache cache(bytes_of(a) + bytes_of(b));
  EXPECT_EQ(put(cache, a), Found::kBuilt);
  EXPECT_EQ(put(cache, b), Found::kBuilt);
  EXPECT_EQ(cache.entry_count(), 2u);
  EXPECT_EQ(cache.bytes(), bytes_of(a) + bytes_of(b));
  EXPECT_EQ(put(cache, a), Found::kHit);  // b is now the oldest
  EXPECT_EQ(put(cache, c), Found::kBuilt);
  EXPECT_FALSE(cache.contains(b.digest));
  EXPECT_TRUE(cache.contains(a.digest));
  EXPECT_TRUE(cache.contains(c.digest));
  EXPECT_EQ(cache.bytes(), bytes_of(a) + bytes_of(c));
  EXPECT_EQ(cache.stats().hits, 1u);
  EXPECT_EQ(cache.stats().misses, 3u);
  EXPECT_EQ(cache.stats().evictions, 1u);
}

// Structures that computations add to a cage count once they are there.
TEST(CageCache, CountsWhatGrew) {
  const Sample a = sample(0), b = sample(1);
  const auto options = *resolve({}, false);
  const auto grown = *a.build()();
  ASSERT_TRUE(grown->prepare(options).ok());
  ASSERT_GT(grown->bytes(), bytes_of(a) + 1000);
  for (const uint64_t room : {grown->bytes() + bytes_of(b), grown->bytes() + bytes_of(b) - 1, grown->bytes() - 1}) {
    CageCache cache(room);
    put(cache, a);
    put(cache, b);
    CageCache::Index held;
    cache.find(a.digest, [&](const Result<CageCache::Index>& index, Found) { held = *index; });
    cache.contains(b.digest);  // a is now the oldest
    ASSERT_TRUE(held->prepare(options).ok());
    cache.recount(*held);
    EXPECT_LE(cache.bytes(), room);
    // The other makes room for it; what is larger than all room goes itself.
    EXPECT_EQ(cache.contains(a.digest), room >= grown->bytes());
    EXPECT_EQ(cache.contains(b.digest), room != grown->bytes() + bytes_of(b) - 1);
    const uint64_t before = cache.bytes();
    cache.recount(*grown);  // the same cage, but not the one held
    EXPECT_EQ(cache.bytes(), before);
  }
}

// Tables that a request or an upload filled count as well.
TEST(CageCache, CountsTables) {
  const Sample a = sample(0);
  CageCache cache(1 << 30);
  CageCache::Index held;
  cache.get(a.digest, a.build(), [&](const Result<CageCache::Index>& index, Found) { held = *index; });
  Options options;
  options.tables = true;
  ASSERT_TRUE(held->prepare(*resolve(options, false)).ok());
  cache.recount(*held);
  const uint64_t before = cache.bytes();
  EXPECT_EQ(held->table_count(), 0u);
  const std::atomic<bool> never = false;
  EXPECT_EQ(held->fill_tables(50, never), 50u);
  EXPECT_EQ(held->table_count(), 50u);
  EXPECT_EQ(cache.bytes(), before);
  cache.recount(*held);
  EXPECT_EQ(cache.bytes(), held->bytes());
  EXPECT_GT(cache.bytes(), before + 50 * 9 * 4 * sizeof(float));
}

TEST(CageCache, ServesButDoesNotKeepWhatIsTooLarge) {
  const Sample a = sample(0);
  CageCache cache(bytes_of(a) - 1);
  EXPECT_EQ(put(cache, a), Found::kBuilt);
  EXPECT_EQ(cache.entry_count(), 0u);
  EXPECT_EQ(cache.bytes(), 0u);
  EXPECT_EQ(put(cache, a), Found::kBuilt);
}

TEST(CageCache, AnEvictedEntryLivesOnWithItsUsers) {
  const Sample a = sample(0), b = sample(1);
  CageCache cache(bytes_of(a));
  CageCache::Index held;
  cache.get(a.digest, a.build(), [&](const Result<CageCache::Index>& index, Found) { held = *index; });
  put(cache, b);
  EXPECT_FALSE(cache.contains(a.digest));
  EXPECT_EQ(held->control_vertex_count(), 4u);
}

TEST(CageCache, AFailureReachesTheCallerAndIsNotKept) {
  const Sample a = sample(0);
  CageCache cache(1 << 20);
  bool heard = false;
  const auto fail = []() -> Result<CageCache::Index> { return invalid_argument("cage", "bad"); };
  cache.get(a.digest, fail, [&](const Result<CageCache::Index>& index, Found) { heard = !index.ok(); });
  EXPECT_TRUE(heard);
  const auto exhaust = []() -> Result<CageCache::Index> { throw std::bad_alloc(); };
  cache.get(a.digest, exhaust, [&](const Result<CageCache::Index>& index, Found) {
    EXPECT_EQ(index.error().code, ErrorCode::kResourceExhausted);
  });
  EXPECT_EQ(cache.entry_count(), 0u);
  EXPECT_EQ(put(cache, a), Found::kBuilt);
}

TEST(CageCache, FindNeverBuilds) {
  const Sample a = sample(0);
  CageCache cache(1 << 30);
  EXPECT_EQ(cache.find(a.digest, [](const Result<CageCache::Index>&, Found) { FAIL(); }), Found::kMissing);
  put(cache, a);
  int calls = 0;
  EXPECT_EQ(cache.find(a.digest, [&](const Result<CageCache::Index>&, Found) { ++calls; }), Found::kHit);
  EXPECT_EQ(calls, 1);
}

// One build, however many ask; those who wait are called with its outcome, good or bad.
void many_ask(bool fails) {
  constexpr int kThreads = 16;
  const Sample a = sample(0);
  CageCache cache(1 << 30);
  std::mutex mutex;
  std::condition_variable joined_all;
  int joined = 0;
  std::atomic<int> builds = 0, answered = 0, good = 0;
  const auto build = [&]() -> Result<CageCache::Index> {
    ++builds;
    std::unique_lock lock(mutex);
    // Everyone else asks while this build is under way.
    EXPECT_TRUE(joined_all.wait_for(lock, std::chrono::seconds(30), [&] { return joined == kThreads - 1; }));
    if (fails) return invalid_argument("cage", "bad");
    return a.build()();
  };
  const auto waiter = [&](const Result<CageCache::Index>& index, Found) {
    ++answered;
    good += index.ok();
  };
  std::vector<std::thread> threads;
  for (int i = 0; i < kThreads; ++i) {
    threads.emplace_back([&] {
      if (cache.get(a.digest, build, waiter) != Found::kJoined) return;
      const std::lock_guard lock(mutex);
      ++joined;
      joined_all.notify_all();
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(builds, 1);
  EXPECT_EQ(answered, kThreads);
  EXPECT_EQ(good, fails ? 0 : kThreads);
  EXPECT_EQ(cache.contains(a.digest), !fails);
}

TEST(CageCache, BuildsOnceForMany) {
  many_ask(false);
}
TEST(CageCache, AFailureReachesAllWhoWait) {
  many_ask(true);
}

TEST(CageCache, KeepsItsBoundUnderLoad) {
  std::vector<Sample> samples;
  for (int i = 0; i < 8; ++i) samples.push_back(sample(i));
  const uint64_t bound = 3 * bytes_of(samples[0]) + 1;
  CageCache cache(bound);
  std::atomic<int> answered = 0;
  std::vector<std::thread> threads;
  for (size_t t = 0; t < 8; ++t) {
    threads.emplace_back([&, t] {
      for (size_t i = 0; i < 50; ++i) {
        const Sample& s = samples[(i * (2 * t + 1)) % samples.size()];
        cache.get(s.digest, s.build(), [&](const Result<CageCache::Index>& index, Found) {
          EXPECT_EQ((*index)->digest(), s.digest);
          ++answered;
        });
        EXPECT_LE(cache.bytes(), bound);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(answered, 400);
  EXPECT_EQ(cache.entry_count(), 3u);
}

}  // namespace
}  // namespace barycast::server
