#pragma once

// What the server is doing and has done, for drain, for metrics, for tests and for people. Lock-free; each
// number is exact by itself, several read together need not be of one instant. Calls add to it at their
// end and tasks at their start, so that nothing here is touched per point or per sample.

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

namespace barycast::server {

enum class Method { kGetCapabilities, kFindMissingCages, kUploadCage, kEstimateCost, kComputeCoordinates };
inline constexpr size_t kMethodCount = 5;
const char* method_name(Method method);

// gRPC's status codes are 0 to 16.
inline constexpr size_t kCodeCount = 17;
const char* code_name(size_t code);

// Stages of a computation by wall time, as in Summary.times.
inline constexpr std::array<const char*, 6> kStageNames = {
    "cage", "solving", "sampling", "smoothing_factor", "smoothing_solve", "rows"};
using StageSeconds = std::array<double, kStageNames.size()>;

// Durations in two or three buckets a decade up to some seconds, two beyond. Seconds are summed in nanoseconds: 64 bits
// last for centuries.
class DurationHistogram {
 public:
  static constexpr std::array<double, 16> kBounds = {1e-4, 2.5e-4, 5e-4, 1e-3, 2.5e-3, 5e-3, 1e-2, 2.5e-2,
                                                     5e-2, 0.1,    0.25, 0.5,  1.0,    2.5,  10.0, 60.0};
  void observe(double seconds) {
    size_t bucket = 0;
    while (bucket < kBounds.size() && seconds > kBounds[bucket]) ++bucket;
    buckets_[bucket].fetch_add(1, std::memory_order_relaxed);
    sum_ns_.fetch_add(static_cast<uint64_t>(seconds * 1e9), std::memory_order_relaxed);
  }
  uint64_t in_bucket(size_t i) const { return buckets_[i].load(std::memory_order_relaxed); }
  double sum_s() const { return static_cast<double>(sum_ns_.load(std::memory_order_relaxed)) * 1e-9; }

 private:
  std::array<std::atomic<uint64_t>, kBounds.size() + 1> buckets_{};  // the last: longer than all bounds
  std::atomic<uint64_t> sum_ns_{0};
};

struct Counters {
  std::atomic<int64_t> calls_active{0};  // whose end is not yet counted
  std::atomic<uint64_t> calls_ok{0};
  std::atomic<uint64_t> calls_cancelled{0};  // by the client, or past their deadline
  std::atomic<uint64_t> calls_refused{0};
  std::atomic<uint64_t> blocks_produced{0};  // row blocks handed to the transport or ready for it
  std::atomic<uint64_t> steps{0};            // pieces of work done for computations

  std::array<std::array<std::atomic<uint64_t>, kCodeCount>, kMethodCount> calls{};  // ended, by method and code
  std::array<DurationHistogram, kMethodCount> durations{};
  std::array<std::atomic<uint64_t>, kStageNames.size()> stage_ns{};
  std::atomic<uint64_t> samples{0}, rows{0}, entries{0};  // of ended computations, whatever their end
};

}  // namespace barycast::server
