#include "estimate/first_steps.h"

#include <algorithm>

namespace barycast {

void FirstSteps::start(std::span<const Vec<3>> directions, double radius, size_t functions) {
  const auto count = static_cast<double>(directions.size());
  Vec<3> mean = Vec<3>::Zero();
  for (const Vec<3>& direction : directions) mean += direction / count;
  covariance_.setZero();
  for (const Vec<3>& direction : directions) covariance_ += (direction - mean) * (direction - mean).transpose() / count;
  const Eigen::Matrix3d inverse = covariance_.inverse();
  weights_.clear();
  for (const Vec<3>& direction : directions) weights_.push_back(inverse * (direction - mean) / (count * radius));
  radius_ = radius;
  squares_ = 0.0;
  slopes_.assign(3 * functions, 0.0);
}

void FirstSteps::add(size_t i, std::span<const double> found) {
  const Vec<3>& weight = weights_[i];
  const size_t n = found.size();
  double *const x = slopes_.data(), *const y = x + n, *const z = y + n;
  for (size_t v = 0; v < n; ++v) {
    squares_ += found[v] * found[v];
    x[v] += weight[0] * found[v];
    y[v] += weight[1] * found[v];
    z[v] += weight[2] * found[v];
  }
}

double FirstSteps::finish(std::span<const double> sums, std::span<float> gradients) const {
  const auto walks = static_cast<double>(weights_.size());
  const size_t n = sums.size();
  double explained = 0.0;  // of the squares, by the means and the slopes
  for (size_t v = 0; v < n; ++v) {
    const Vec<3> slope(slopes_[v], slopes_[n + v], slopes_[2 * n + v]);
    explained += sums[v] * sums[v] / walks + walks * radius_ * radius_ * slope.dot(covariance_ * slope);
  }
  std::transform(slopes_.begin(), slopes_.end(), gradients.begin(),
                 [](double slope) { return static_cast<float>(slope); });
  double spread = 0.0;
  for (const Vec<3>& weight : weights_) spread += weight.squaredNorm();
  return std::max(0.0, squares_ - explained) / (walks - 4) * spread;
}

}  // namespace barycast
