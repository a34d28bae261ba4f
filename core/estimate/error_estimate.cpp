#include "estimate/error_estimate.h"

#include <algorithm>
#include <cmath>

namespace barycast {
namespace {

// Of the standard normal distribution, at 95 percent.
constexpr double kNormal95 = 1.6448536269514722;

// The 95 percent quantile of F with a and b degrees of freedom [Paulson 1942: its cube root is a ratio of nearly normal
// numbers]. Within a hundredth of it from three and nine degrees on.
double f_quantile_95(double a, double b) {
  const double spread_a = 2 / (9 * a), spread_b = 2 / (9 * b), mean_a = 1 - spread_a, mean_b = 1 - spread_b;
  const double squared = kNormal95 * kNormal95;
  const double p = mean_b * mean_b - squared * spread_b, q = mean_a * mean_b, r = mean_a * mean_a - squared * spread_a;
  const double root = (q + std::sqrt(std::max(0.0, q * q - p * r))) / p;
  return root * root * root;
}

double dot(std::span<const double> a, std::span<const double> b) {
  double sum = 0.0;
  for (size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

}  // namespace

std::span<float> Randomizations::append() {
  rows_.resize(rows_.size() + size_);
  return std::span(rows_).last(size_);
}

void Randomizations::mean(std::span<float> out) const {
  for (size_t k = 0; k < size_; ++k) {
    double sum = 0.0;
    for (size_t i = 0; i < count(); ++i) sum += double{row(i)[k]};
    out[k] = static_cast<float>(sum / static_cast<double>(count()));
  }
}

Randomizations::Error Randomizations::error() const {
  const size_t n = count();
  const auto degrees = static_cast<double>(n - 1);
  std::vector<double> deviation(rows_.begin(), rows_.end());
  for (size_t k = 0; k < size_; ++k) {
    double mean = 0.0;
    for (size_t i = 0; i < n; ++i) mean += deviation[i * size_ + k] / static_cast<double>(n);
    for (size_t i = 0; i < n; ++i) deviation[i * size_ + k] -= mean;
  }
  // The covariance S has the trace and the squares of the small matrix of products between randomizations.
  double trace = 0.0, squares = 0.0;
  for (size_t i = 0; i < n; ++i)
    for (size_t j = 0; j <= i; ++j) {
      const double product =
          dot(std::span(deviation).subspan(i * size_, size_), std::span(deviation).subspan(j * size_, size_)) / degrees;
      squares += (i == j ? 1.0 : 2.0) * product * product;
      if (i == j) trace += product;
    }
  if (!(trace > 0.0)) return {0.0, 0.0};
  double nu = 1.0;  // of two there is nothing to tell by
  if (n > 2) {
    // tr S^2 is overestimated by itself; without bias it varies, and its reciprocal is too large in the mean. The
    // geometric mean of what both say is nearer than either.
    const auto most = static_cast<double>(size_);
    const double unbiased = degrees * degrees / ((degrees + 2) * (degrees - 1)) * (squares - trace * trace / degrees);
    const double high = unbiased > 0.0 ? std::clamp(trace * trace / unbiased, 1.0, most) : most;
    nu = std::sqrt(high * std::clamp(trace * trace / squares, 1.0, most));
  }
  const double variance = trace / static_cast<double>(n);
  return {std::sqrt(variance), std::sqrt(variance * f_quantile_95(nu, nu * degrees))};
}

}  // namespace barycast
