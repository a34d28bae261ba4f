#include "estimate/projection.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "base/tolerances.h"

namespace barycast {
namespace {

template <int N>
bool is_singular(const Mat<N>& matrix) {
  const Eigen::SelfAdjointEigenSolver<Mat<N>> solver(matrix, Eigen::EigenvaluesOnly);
  const auto magnitudes = solver.eigenvalues().cwiseAbs();
  return !(magnitudes.minCoeff() >= kMomentRcondMin * magnitudes.maxCoeff()) || magnitudes.maxCoeff() == 0.0;
}

// Y = local [y; 1], from the cage's frame to the moments'.
template <int D>
Mat<D + 1> to_local(const Moments<D>& moments) {
  Mat<D + 1> local = Mat<D + 1>::Zero();
  local.diagonal().setConstant(moments.scale);
  local(D, D) = 1.0;
  local.template topRightCorner<D, 1>() = -moments.scale * moments.centre;
  return local;
}

}  // namespace

template <int D>
Projection<D>::Projection(const Cage<D>& cage) : cage_(cage), vertex_second_(Mat<D + 1>::Zero()) {
  for (const uint32_t v : cage.used_vertices()) {
    const Vec<D + 1> x = homogeneous<D>(cage.control_vertices()[v]);
    vertex_second_ += x * x.transpose();
  }
}

// Of every used vertex.
template <int D>
double Projection<D>::pseudo_weight(const Moments<D>& moments) const {
  const double mean = moments.sample_count == 0 ? 1.0 : moments.weight_mean;
  return kPseudoSampleWeight * mean / static_cast<double>(cage_.used_vertices().size());
}

template <int D>
void Projection<D>::project(const Moments<D>& moments, PseudoSamples policy, Projected<D>& out) const {
  out.fits.clear();
  out.pseudo.setZero();
  const Mat<D + 1> local = to_local(moments);
  Mat<D + 1> second = moments.second;
  out.singular = moments.sample_count == 0 || (policy == PseudoSamples::kWhenSingular && is_singular<D + 1>(second));
  const bool pseudo = policy == PseudoSamples::kAlways || out.singular;
  const double weight = pseudo_weight(moments);
  if (pseudo) second += weight * (local * vertex_second_ * local.transpose());

  // u_v = M^-1 m_v [SBC Eq. 7], then back: u . Y = (local^T u) . [y; 1].
  const Mat<D + 1> solve = local.transpose() * second.inverse();
  for (const VertexMoment<D>& first : moments.first) out.fits.push_back({first.vertex, solve * first.moment});
  // The pseudo-samples' own m_v is their weight times [x_v; 1], for phi_v is 1 there and the others are 0.
  if (pseudo) out.pseudo = weight * (solve * local);
}

template <int D>
Mat<D + 1> Projection<D>::magnitude(const Moments<D>& moments, const Mat<D + 1>& local) const {
  return moments.second - 2 * moments.negative + pseudo_weight(moments) * (local * vertex_second_ * local.transpose());
}

// Of A^-1/2 M A^-1/2 no eigenvalue is larger than 1, so that the least is no less than their product.
template <int D>
bool Projection<D>::amplify_less(const Moments<D>& moments, double limit) const {
  const double whole = magnitude(moments, to_local(moments)).determinant();
  constexpr double kSurely = 1.01;  // rounding is far less, for moments are scaled to their spread
  return whole > 0.0 && std::abs(moments.second.determinant()) * limit > kSurely * whole;
}

template <int D>
typename Projection<D>::Amplification Projection<D>::amplification(const Moments<D>& moments, const Vec<D>& x) const {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const Mat<D + 1> local = to_local(moments);
  // A = sum |w| y y^T. Where it is the identity the fits of positive weights have unit variance in every direction,
  // and those of signed ones that of M^-1.
  const Eigen::LLT<Mat<D + 1>> root(magnitude(moments, local));
  if (root.info() != Eigen::Success) return {kInfinity, kInfinity};
  Mat<D + 1> whitened = root.matrixL().solve(moments.second);
  whitened = root.matrixL().solve(Mat<D + 1>(whitened.transpose()));
  const Eigen::SelfAdjointEigenSolver<Mat<D + 1>> solver(whitened);
  const double least = solver.eigenvalues().cwiseAbs().minCoeff();
  if (!(least > 0.0)) return {kInfinity, kInfinity};
  const Vec<D + 1> at = root.matrixL().solve(Vec<D + 1>(local * homogeneous<D>(x)));
  const Vec<D + 1> amplified = solver.eigenvalues().cwiseInverse().cwiseProduct(solver.eigenvectors().transpose() * at);
  return {amplified.norm() / at.norm(), 1.0 / least};
}

template <int D>
void Projection<D>::pin(const CagePoint<D>& y, Projected<D>& projected) const {
  std::vector<VertexWeight> basis;
  cage_.append_basis(cage_.elements()[y.element], y.shares, 1.0, basis);
  for (LinearFit<D>& fit : projected.fits) fit.u[D] = -fit.u.template head<D>().dot(y.point);
  projected.pseudo.row(D) = -y.point.transpose() * projected.pseudo.template topRows<D>();
  for (const VertexWeight& phi : basis) {
    auto at = std::lower_bound(projected.fits.begin(), projected.fits.end(), phi.vertex,
                               [](const LinearFit<D>& fit, uint32_t vertex) { return fit.vertex < vertex; });
    if (at == projected.fits.end() || at->vertex != phi.vertex)
      at = projected.fits.insert(at, {phi.vertex, Vec<D + 1>::Zero()});
    at->u[D] += phi.weight;
  }
}

template class Projection<2>;
template class Projection<3>;

}  // namespace barycast
