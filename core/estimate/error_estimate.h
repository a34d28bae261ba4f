#pragma once

// How far an estimate is from its mean, from independent randomizations of it: its noise. Of bias they know nothing.

#include <cstddef>
#include <span>
#include <vector>

namespace barycast {

// Estimates of one vector, all of equal noise and independent: their mean, and what it is off by.
class Randomizations {
 public:
  explicit Randomizations(size_t size = 0) : size_(size) {}

  void clear(size_t size) {
    size_ = size;
    rows_.clear();
  }
  // The next one, to be written.
  std::span<float> append();
  size_t count() const { return size_ == 0 ? 0 : rows_.size() / size_; }

  void mean(std::span<float> out) const;

  struct Error {
    double standard;  // sqrt of the mean's variances, summed over the vector
    // The distance of the mean from what it is an estimate of is below this for 95 in 100 vectors, were they normal:
    // the quantile of F with nu and nu (count - 1) degrees of freedom, nu those of the sum of squares [Satterthwaite
    // 1946: (tr S)^2 / tr S^2]. From eight on for 94 to 96 in 100, and for more where all numbers vary alike.
    double at_95;
  };
  // Of two and more.
  Error error() const;

 private:
  std::span<const float> row(size_t i) const { return std::span(rows_).subspan(i * size_, size_); }

  size_t size_;
  std::vector<float> rows_;
};

}  // namespace barycast
