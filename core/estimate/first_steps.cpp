#include "estimate/first_steps.h"

#include <algorithm>

namespace barycast {

void FirstSteps::start(std::span<const Vec<3>> directions, double radius, size_t functions) {
  const auto count = static_cast<double>(directions.size());
  Vec<3> mean = Vec<3>::Zero();
  for (const Vec<3> &direction : directions) mean += direction / count;
  covariance_.setZero();
  for (const Vec<3> &direction : directions) covariance_ += (direction - mean) * (direction - mean).transpose() / count;
  const Eigen::Matrix3d inverse = covariance_.inverse();
  weights_.clear();
  for (const Vec<3> &direction : directions) weights_.push_back(inverse * (direction - mean) / (count * radius));
  radius_ = radius;
  squares_.assign(functions, 0.0);
  slopes_.assign(3 * functions, 0.0);
}

void FirstSteps::add(size_t i, std::span<const double> found) {
  using Functions = Eigen::Array<double, Eigen::Dynamic, 1>;
  const auto n = static_cast<Eigen::Index>(found.size());
  const Eigen::Map<const Functions> values(found.data(), n);
  Eigen::Map<Functions>(squares_.data(), n) += values.square();
  for (Eigen::Index a = 0; a < 3; ++a) Eigen::Map<Functions>(slopes_.data() + a * n, n) += weights_[i][a] * values;
}

double FirstSteps::finish(std::span<const double> sums, std::span<float> gradients) const {
  const auto walks = static_cast<double>(weights_.size());
  const size_t n = sums.size();
  const double *const x = slopes_.data(), *const y = x + n, *const z = y + n;
  const Eigen::Matrix3d scaled = walks * radius_ * radius_ * covariance_;
  double unexplained = 0.0;  // squares, by the means and the slopes
  for (size_t v = 0; v < n; ++v) {
    const double by_slope = x[v] * (scaled(0, 0) * x[v] + 2 * (scaled(0, 1) * y[v] + scaled(0, 2) * z[v])) +
                            y[v] * (scaled(1, 1) * y[v] + 2 * scaled(1, 2) * z[v]) + z[v] * scaled(2, 2) * z[v];
    unexplained += squares_[v] - sums[v] * sums[v] / walks - by_slope;
  }
  std::transform(slopes_.begin(), slopes_.end(), gradients.begin(),
                 [](double slope) { return static_cast<float>(slope); });
  double spread = 0.0;
  for (const Vec<3> &weight : weights_) spread += weight.squaredNorm();
  return std::max(0.0, unexplained) / (walks - 4) * spread;
}

}  // namespace barycast
