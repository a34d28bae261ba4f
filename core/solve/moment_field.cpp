#include "solve/moment_field.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "base/check.h"

namespace barycast {
namespace {

// Eigenvalues of the covariance below this times the largest are errors of the moments, not a spread.
constexpr double kSpreadMin = 1e-8;
// And below this times the second moments they are roundings: next to the cage all of a measure is in one place.
constexpr double kRounding = 1e-14;

// Moments of all control vertices: mass, mean and covariance of the measure.
struct Spread {
  double mass = 0.0;
  Vec<3> first = Vec<3>::Zero();  // int z
  Mat<3> second = Mat<3>::Zero();

  Spread(const BoundaryData::Row& moments, Eigen::Index n) {
    mass = moments.head(n).sum();
    for (Eigen::Index v = 0; v < n; ++v) first += moments.segment<3>(n + 3 * v).transpose();
    const auto s = moments.tail<6>();
    second << s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5];
  }
};

}  // namespace

MomentProjection::MomentProjection(const BoundaryData& data, const Vec<3>& x, const BoundaryData::Row& moments)
    : data_(data), moments_(moments) {
  BARYCAST_CHECK_OP(moments.size(), ==, data.count());
  const Spread spread(moments, data.basis_count());
  mass_ = spread.mass;
  mean_ = spread.first / spread.mass;
  second_ = spread.second;
  const Mat<3> covariance = spread.second / spread.mass - mean_ * mean_.transpose();
  const Eigen::SelfAdjointEigenSolver<Mat<3>> solver(covariance);
  const double least =
      std::max(kSpreadMin * solver.eigenvalues()[2], kRounding * std::abs(spread.second.trace() / spread.mass));
  Vec<3> inverse_eigenvalues = Vec<3>::Zero();
  for (Eigen::Index i = 0; i < 3; ++i)
    if (solver.eigenvalues()[i] > least) inverse_eigenvalues[i] = 1 / solver.eigenvalues()[i];
  spans_ = inverse_eigenvalues.minCoeff() > 0.0;
  inverse_ = solver.eigenvectors() * inverse_eigenvalues.asDiagonal() * solver.eigenvectors().transpose();
  q_ = inverse_ * (data.to_moments(x) - mean_);
}

// alpha_v = (m_v + q . (p_v - mean m_v)) / mass with q = C^-1 (x - mean): the linear fit of phi_v, at x.
void MomentProjection::values(Eigen::Ref<BoundaryData::Row> out) const {
  const Eigen::Index n = data_.basis_count();
  for (Eigen::Index v = 0; v < n; ++v) {
    const Vec<3> p = moments_.segment<3>(n + 3 * v).transpose();
    out[v] = (moments_[v] + q_.dot(p - mean_ * moments_[v])) / mass_;
  }
}

void MomentProjection::change(const Vec<3>& point, const BoundaryData::Row& moments,
                              Eigen::Ref<BoundaryData::Row> out) const {
  const Eigen::Index n = data_.basis_count();
  const Spread change(moments, n);
  const double mass_rate = change.mass / mass_;
  const Vec<3> mean_change = change.first / mass_ - mean_ * mass_rate;
  const Mat<3> covariance_change = change.second / mass_ - second_ * (mass_rate / mass_) -
                                   mean_change * mean_.transpose() - mean_ * mean_change.transpose();
  const Vec<3> q_change = inverse_ * (data_.direction_to_moments() * point - mean_change - covariance_change * q_);
  for (Eigen::Index v = 0; v < n; ++v) {
    const Vec<3> p = moments_.segment<3>(n + 3 * v).transpose(), p_change = moments.segment<3>(n + 3 * v).transpose();
    const Vec<3> off = p - mean_ * moments_[v];
    const double value = (moments_[v] + q_.dot(off)) / mass_;
    out[v] =
        (moments[v] + q_change.dot(off) + q_.dot(p_change - mean_change * moments_[v] - mean_ * moments[v])) / mass_ -
        value * mass_rate;
  }
}

bool project_moments(const BoundaryData& data, const Vec<3>& x, const BoundaryData::Row& moments,
                     const std::array<BoundaryData::Row, 3>& slopes, Eigen::Ref<BoundaryData::Row> values,
                     std::array<BoundaryData::Row, 3>& gradients) {
  const MomentProjection projection(data, x, moments);
  projection.values(values);
  for (Eigen::Index k = 0; k < 3 && slopes[0].size() > 0; ++k) {
    BoundaryData::Row& gradient = gradients[static_cast<size_t>(k)];
    gradient.resize(data.basis_count());
    projection.change(Vec<3>::Unit(k), slopes[static_cast<size_t>(k)], gradient);
  }
  return projection.spans();
}

}  // namespace barycast
