#pragma once

// How far an estimate is from its mean, from independent randomizations of it: its noise. Of bias they know nothing.

#include <cstddef>
#include <span>
#include <vector>

namespace barycast {

// Estimates of one vector, all of equal noise and independent: their mean, and what it is off by. Kept as the sums of
// batches, at most kBatchesMost: when there are as many, every two become one.
class Randomizations {
 public:
  static constexpr size_t kBatchesMost = 64;

  explicit Randomizations(size_t size = 0) : size_(size) {}

  void clear(size_t size);
  void add(std::span<const float> estimate);
  size_t count() const { return count_; }

  void mean(std::span<float> out) const;
  // Means of equally many estimates each: the batches that are complete.
  size_t batch_count() const { return count_ / batch_; }
  void batch_mean(size_t i, std::span<float> out) const;

  struct Error {
    double standard;  // sqrt of the mean's variances, summed over the vector
    // The distance of the mean from what it is an estimate of is below this for 95 in 100 vectors, were they normal:
    // the quantile of F with nu and nu (batches - 1) degrees of freedom, nu those of the sum of squares [Satterthwaite
    // 1946: (tr S)^2 / tr S^2]. From eight on for 94 to 97 in 100.
    double at_95;
  };
  // Of two batches and more, all complete: those of a power of two are.
  Error error() const;

 private:
  std::span<float> sum(size_t i) { return std::span(sums_).subspan(i * size_, size_); }
  std::span<const float> sum(size_t i) const { return std::span(sums_).subspan(i * size_, size_); }

  size_t size_;
  size_t count_ = 0, batch_ = 1;  // of estimates: in all, in a batch
  std::vector<float> sums_;       // of the batches
};

}  // namespace barycast
