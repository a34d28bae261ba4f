#include "estimate/row.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "base/tolerances.h"

namespace barycast {
namespace {

// Count, mean and scatter about the mean of a growing set of points.
template <int D>
class Scatter {
 public:
  void add(const Vec<D>& x) {
    ++count_;
    const Vec<D> from_old = x - mean_;
    mean_ += from_old / count_;
    scatter_ += from_old * (x - mean_).transpose();
  }
  double smallest() const {
    // By iteration, not by Eigen's closed form: its sines and cosines come from the system's library.
    return Eigen::SelfAdjointEigenSolver<Mat<D>>(scatter_, Eigen::EigenvaluesOnly).eigenvalues()[0];
  }

 private:
  double count_ = 0.0;
  Vec<D> mean_ = Vec<D>::Zero();
  Mat<D> scatter_ = Mat<D>::Zero();
};

// d + 1 points far apart: the farthest from the mean, then each the farthest from the span of the
// ones before.
template <int D>
std::vector<uint32_t> spread_simplex(std::span<const uint32_t> vertices, std::span<const Vec<D>> points) {
  std::vector<uint32_t> chosen;
  Vec<D> origin = Vec<D>::Zero();
  for (const uint32_t v : vertices) origin += points[v];
  origin /= static_cast<double>(vertices.size());
  Mat<D> outside_span = Mat<D>::Identity();
  for (int k = 0; k <= D; ++k) {
    uint32_t best = vertices[0];
    double best_distance = -1.0;
    for (const uint32_t v : vertices)
      if (const double distance = (outside_span * (points[v] - origin)).squaredNorm(); distance > best_distance) {
        best = v;
        best_distance = distance;
      }
    chosen.push_back(best);
    if (k == 0) {
      origin = points[best];
    } else {
      const Vec<D> direction = (outside_span * (points[best] - origin)).normalized();
      outside_span -= direction * direction.transpose() * outside_span;
    }
  }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

}  // namespace

template <int D>
RowFinisher<D>::RowFinisher(const Cage<D>& cage, const RowSettings& settings)
    : cage_(cage),
      settings_(settings),
      prune_gradient_below_(kPruneGradientFactor * settings.prune_below),
      reach_(0.0) {
  Vec<D> mean = Vec<D>::Zero();
  const auto count = static_cast<double>(cage.used_vertices().size());
  for (const uint32_t v : cage.used_vertices()) mean += cage.control_vertices()[v] / count;
  Mat<D> covariance = Mat<D>::Zero();
  for (const uint32_t v : cage.used_vertices()) {
    const Vec<D> x = cage.control_vertices()[v] - mean;
    covariance += x * x.transpose() / count;
    reach_ = std::max(reach_, homogeneous<D>(cage.control_vertices()[v]).norm());
  }
  const Eigen::SelfAdjointEigenSolver<Mat<D>> solver(covariance);
  whitening_ = solver.eigenvalues().cwiseSqrt().cwiseInverse().asDiagonal() * solver.eigenvectors().transpose();
  std::vector<Vec<D>> whitened;
  for (const Vec<D>& x : cage.control_vertices()) whitened.push_back(whitening_ * x);
  simplex_ = spread_simplex<D>(cage.used_vertices(), whitened);
}

template <int D>
void RowFinisher<D>::evaluate(const Projected<D>& projected, const Vec<D>& x, std::vector<RowEntry<D>>& row) const {
  row.clear();
  const Vec<D + 1> at = homogeneous<D>(x);
  const auto append = [&](uint32_t vertex, const Vec<D + 1>& u) {
    row.push_back({vertex, u.dot(at), u.template head<D>()});  // [SBC Eq. 10]
  };
  // The pseudo-samples' share of any vertex is at most this; where all of it would be pruned, only the
  // vertices that samples touched need a look. The final correction makes up for the rest.
  const double value_max = reach_ * (projected.pseudo.transpose() * at).norm();
  const double gradient_max = reach_ * projected.pseudo.template topRows<D>().norm();
  if (settings_.prune_below > 0.0 ? !is_kept(value_max, gradient_max) : value_max == 0.0 && gradient_max == 0.0) {
    for (const LinearFit<D>& fit : projected.fits)
      append(fit.vertex, fit.u + projected.pseudo * homogeneous<D>(cage_.control_vertices()[fit.vertex]));
    return;
  }
  auto fit = projected.fits.begin();
  for (const uint32_t v : cage_.used_vertices()) {
    Vec<D + 1> u = projected.pseudo * homogeneous<D>(cage_.control_vertices()[v]);
    if (fit != projected.fits.end() && fit->vertex == v) u += (fit++)->u;
    append(v, u);
  }
}

template <int D>
void RowFinisher<D>::prune(std::vector<RowEntry<D>>& row) const {
  std::vector<RowEntry<D>> kept, rest;
  Scatter<D> scatter;
  const auto whitened = [&](uint32_t v) { return Vec<D>(whitening_ * cage_.control_vertices()[v]); };
  for (const RowEntry<D>& entry : row) {
    if (is_kept(std::abs(entry.value), entry.gradient.norm())) {
      kept.push_back(entry);
      scatter.add(whitened(entry.vertex));
    } else {
      rest.push_back(entry);
    }
  }
  if (scatter.smallest() < kKeptSpanMin) {
    std::stable_sort(rest.begin(), rest.end(),
                     [](const RowEntry<D>& a, const RowEntry<D>& b) { return std::abs(a.value) > std::abs(b.value); });
    // Below this the order is one of rounding errors, and explicit zeros say as much.
    const double negligible = 1e-3 * settings_.prune_below;
    for (auto next = rest.begin();
         next != rest.end() && std::abs(next->value) > negligible && scatter.smallest() < kKeptSpanMin; ++next) {
      kept.push_back(*next);
      scatter.add(whitened(next->vertex));
    }
    const bool spans = scatter.smallest() >= kKeptSpanMin;
    if (!spans)
      for (const uint32_t v : simplex_)
        if (std::none_of(kept.begin(), kept.end(), [&](const RowEntry<D>& entry) { return entry.vertex == v; }))
          kept.push_back({v, 0.0, Vec<D>::Zero()});
    std::sort(kept.begin(), kept.end(), [](const RowEntry<D>& a, const RowEntry<D>& b) { return a.vertex < b.vertex; });
  }
  row.swap(kept);
}

// Minimum-norm change of values and gradients that restores linear precision [SBC Eq. 4]. About the mean of the kept
// vertices the constraints of sum and position are orthogonal, so each is met on its own.
template <int D>
double RowFinisher<D>::correct(const Vec<D>& x, std::vector<RowEntry<D>>& row) const {
  const auto vertices = cage_.control_vertices();
  Vec<D> mean = Vec<D>::Zero();
  const auto count = static_cast<double>(row.size());
  for (const RowEntry<D>& entry : row) mean += vertices[entry.vertex] / count;
  Mat<D> scatter = Mat<D>::Zero();
  for (const RowEntry<D>& entry : row) {
    const Vec<D> from_mean = vertices[entry.vertex] - mean;
    scatter += from_mean * from_mean.transpose();
  }
  const Eigen::LDLT<Mat<D>> solver(scatter);
  // The second pass removes what the first one's rounding left; the third only measures.
  for (int pass = 0;; ++pass) {
    double sum = 1.0;
    Vec<D> position = x - mean, gradient_sum = Vec<D>::Zero();
    Mat<D> jacobian = Mat<D>::Identity();
    for (const RowEntry<D>& entry : row) {
      const Vec<D> from_mean = vertices[entry.vertex] - mean;
      sum -= entry.value;
      position -= entry.value * from_mean;
      gradient_sum -= entry.gradient;
      jacobian -= entry.gradient * from_mean.transpose();
    }
    if (pass == 2) return (position + sum * mean).norm() / std::max(1.0, x.norm());
    const Vec<D> position_change = solver.solve(position);
    const Mat<D> jacobian_change = solver.solve(jacobian.transpose()).transpose();
    for (RowEntry<D>& entry : row) {
      const Vec<D> from_mean = vertices[entry.vertex] - mean;
      entry.value += sum / count + position_change.dot(from_mean);
      if (settings_.gradients) entry.gradient += gradient_sum / count + jacobian_change * from_mean;
    }
  }
}

template <int D>
double RowFinisher<D>::finish(const Vec<D>& x, std::vector<RowEntry<D>>& row) const {
  prune(row);
  return correct(x, row);
}

template class RowFinisher<2>;
template class RowFinisher<3>;

}  // namespace barycast
