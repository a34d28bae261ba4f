#include "estimate/solid_harmonics.h"

#include <Eigen/Cholesky>
#include <cmath>

namespace barycast {
namespace {

using Values = Eigen::Matrix<double, kHarmonics, 1>;

Values values_at(const Vec<3>& p) {
  const double x = p[0], y = p[1], z = p[2];
  const double first = std::sqrt(3.0), second = std::sqrt(15.0);
  Values b;
  b << 1, first * x, first * y, first * z, second * x * y, second * y * z, second * z * x,
      0.5 * second * (x * x - y * y), 0.5 * std::sqrt(5.0) * (2 * z * z - x * x - y * y);
  return b;
}

HarmonicValues in_floats(const Values& b) {
  HarmonicValues result;
  for (size_t j = 0; j < kHarmonics; ++j) result[j] = static_cast<float>(b[static_cast<Eigen::Index>(j)]);
  return result;
}

}  // namespace

HarmonicValues solid_harmonics(const Vec<3>& x) {
  return in_floats(values_at(x));
}

std::vector<HarmonicValues> harmonic_projection(std::span<const Vec<3>> directions) {
  Eigen::Matrix<double, kHarmonics, kHarmonics> gram = Eigen::Matrix<double, kHarmonics, kHarmonics>::Zero();
  for (const Vec<3>& s : directions) {
    const Values b = values_at(s);
    gram += b * b.transpose();
  }
  const Eigen::LLT<Eigen::Matrix<double, kHarmonics, kHarmonics>> factor(gram);
  std::vector<HarmonicValues> factors;
  factors.reserve(directions.size());
  for (const Vec<3>& s : directions) factors.push_back(in_floats(factor.solve(values_at(s))));
  return factors;
}

}  // namespace barycast
