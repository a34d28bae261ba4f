#include "estimate/solid_harmonics.h"

#include <Eigen/Cholesky>
#include <cmath>

namespace barycast {
namespace {

using Values = Eigen::Matrix<double, kHarmonics, 1>;

const double kFirst = std::sqrt(3.0), kSecond = std::sqrt(15.0), kAxial = std::sqrt(5.0);

Values values_at(const Vec<3>& p) {
  const double x = p[0], y = p[1], z = p[2];
  Values b;
  b << 1, kFirst * x, kFirst * y, kFirst * z, kSecond * x * y, kSecond * y * z, kSecond * z * x,
      0.5 * kSecond * (x * x - y * y), 0.5 * kAxial * (2 * z * z - x * x - y * y);
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

std::array<HarmonicValues, 3> solid_harmonic_gradients(const Vec<3>& p) {
  const double x = p[0], y = p[1], z = p[2];
  Values by_x, by_y, by_z;
  by_x << 0, kFirst, 0, 0, kSecond * y, 0, kSecond * z, kSecond * x, -kAxial * x;
  by_y << 0, 0, kFirst, 0, kSecond * x, kSecond * z, 0, -kSecond * y, -kAxial * y;
  by_z << 0, 0, 0, kFirst, 0, kSecond * y, kSecond * x, 0, 2 * kAxial * z;
  return {in_floats(by_x), in_floats(by_y), in_floats(by_z)};
}

std::vector<HarmonicValues> harmonic_projection(std::span<const Vec<3>> directions) {
  Eigen::Matrix<double, kHarmonics, kHarmonics> gram = Eigen::Matrix<double, kHarmonics, kHarmonics>::Zero();
  for (const Vec<3>& s : directions) {
    const Values b = values_at(s);
    gram += b * b.transpose();
  }
  using Gram = Eigen::Matrix<double, kHarmonics, kHarmonics>;
  const Gram inverse = gram.llt().solve(Gram::Identity());  // nearly diagonal: directions are spread evenly
  std::vector<HarmonicValues> factors;
  factors.reserve(directions.size());
  for (const Vec<3>& s : directions) factors.push_back(in_floats(inverse * values_at(s)));
  return factors;
}

}  // namespace barycast
