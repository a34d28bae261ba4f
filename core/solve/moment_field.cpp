#include "solve/moment_field.h"

#include <Eigen/Eigenvalues>

#include "base/check.h"

namespace barycast {
namespace {

// Eigenvalues of the covariance below this times the largest are errors of the moments, not a spread.
constexpr double kSpreadMin = 1e-8;

// Moments of all control vertices: mass, mean and covariance of the measure.
struct Spread {
  double mass = 0.0;
  Vec<3> first = Vec<3>::Zero();  // int y
  Mat<3> second = Mat<3>::Zero();

  Spread(const BoundaryData::Row& moments, Eigen::Index n) {
    mass = moments.head(n).sum();
    for (Eigen::Index v = 0; v < n; ++v) first += moments.segment<3>(n + 3 * v).transpose();
    const auto s = moments.tail<6>();
    second << s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5];
  }
};

}  // namespace

bool project_moments(const Vec<3>& x, const BoundaryData::Row& moments, const std::array<BoundaryData::Row, 3>& slopes,
                     Eigen::Index control_vertices, Eigen::Ref<BoundaryData::Row> values,
                     std::array<BoundaryData::Row, 3>& gradients) {
  const Eigen::Index n = control_vertices;
  BARYCAST_CHECK_OP(moments.size(), ==, 4 * n + 6);
  const Spread spread(moments, n);
  const Vec<3> mean = spread.first / spread.mass;
  const Mat<3> covariance = spread.second / spread.mass - mean * mean.transpose();
  const Eigen::SelfAdjointEigenSolver<Mat<3>> solver(covariance);
  Vec<3> inverse_eigenvalues = Vec<3>::Zero();
  for (Eigen::Index i = 0; i < 3; ++i)
    if (solver.eigenvalues()[i] > kSpreadMin * solver.eigenvalues()[2])
      inverse_eigenvalues[i] = 1 / solver.eigenvalues()[i];
  const Mat<3> inverse = solver.eigenvectors() * inverse_eigenvalues.asDiagonal() * solver.eigenvectors().transpose();

  // alpha_v = (m_v + q . (p_v - mean m_v)) / mass with q = C^-1 (x - mean): the linear fit of phi_v, at x.
  const Vec<3> q = inverse * (x - mean);
  for (Eigen::Index v = 0; v < n; ++v) {
    const Vec<3> p = moments.segment<3>(n + 3 * v).transpose();
    values[v] = (moments[v] + q.dot(p - mean * moments[v])) / spread.mass;
  }
  for (Eigen::Index k = 0; k < 3 && slopes[0].size() > 0; ++k) {
    const BoundaryData::Row& slope = slopes[static_cast<size_t>(k)];
    const Spread change(slope, n);
    const double mass_rate = change.mass / spread.mass;
    const Vec<3> mean_change = change.first / spread.mass - mean * mass_rate;
    const Mat<3> covariance_change = change.second / spread.mass - spread.second * (mass_rate / spread.mass) -
                                     mean_change * mean.transpose() - mean * mean_change.transpose();
    const Vec<3> q_change = inverse * (Vec<3>::Unit(k) - mean_change - covariance_change * q);
    BoundaryData::Row& gradient = gradients[static_cast<size_t>(k)];
    gradient.resize(n);
    for (Eigen::Index v = 0; v < n; ++v) {
      const Vec<3> p = moments.segment<3>(n + 3 * v).transpose(), p_change = slope.segment<3>(n + 3 * v).transpose();
      gradient[v] = (slope[v] + q_change.dot(p - mean * moments[v]) +
                     q.dot(p_change - mean_change * moments[v] - mean * slope[v])) /
                        spread.mass -
                    values[v] * mass_rate;
    }
  }
  return inverse_eigenvalues.minCoeff() > 0.0;
}

}  // namespace barycast
