#include "estimate/row.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>

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
  // Whether the scatter in every direction is `least` or more.
  bool spans(double least) const {
    // Of three eigenvalues, two have no larger product than the square of half of the sum. Most sets are so far from
    // flat that this decides.
    const double half = 0.5 * scatter_.trace();
    const double sum_of_others = D == 3 ? half * half : scatter_.trace();
    if (scatter_.determinant() > kSurely * least * sum_of_others) return true;
    return smallest() >= least;
  }

 private:
  static constexpr double kSurely = 1.000001;
  double smallest() const {
    // By iteration, not by Eigen's closed form: its sines and cosines come from the system's library.
    return Eigen::SelfAdjointEigenSolver<Mat<D>>(scatter_, Eigen::EigenvaluesOnly).eigenvalues()[0];
  }

  double count_ = 0.0;
  Vec<D> mean_ = Vec<D>::Zero();
  Mat<D> scatter_ = Mat<D>::Zero();
};

// The affine span of a growing set of points.
template <int D>
class AffineSpan {
 public:
  // Directions that the set does not span yet, counting the first point as one: d + 1 at the beginning.
  size_t missing() const { return D + 1 - count_; }
  // Of a point from the span; infinite while there is no point.
  double distance(const Vec<D>& x) const {
    return count_ == 0 ? std::numeric_limits<double>::infinity() : (outside_ * (x - origin_)).norm();
  }
  // A point off the span.
  void add(const Vec<D>& x) {
    if (count_++ == 0) {
      origin_ = x;
      return;
    }
    const Vec<D> direction = (outside_ * (x - origin_)).normalized();
    outside_ -= direction * (direction.transpose() * outside_);
  }

 private:
  size_t count_ = 0;
  Vec<D> origin_ = Vec<D>::Zero();
  Mat<D> outside_ = Mat<D>::Identity();  // projects onto what is not spanned
};

// d + 1 points far apart: the farthest from the mean, then each the farthest from the span of the ones before.
template <int D>
std::vector<uint32_t> spread_simplex(std::span<const uint32_t> vertices, std::span<const Vec<D>> points) {
  Vec<D> mean = Vec<D>::Zero();
  for (const uint32_t v : vertices) mean += points[v] / static_cast<double>(vertices.size());
  AffineSpan<D> span;
  std::vector<uint32_t> chosen;
  while (span.missing() > 0) {
    const auto farness = [&](uint32_t v) {
      return chosen.empty() ? (points[v] - mean).norm() : span.distance(points[v]);
    };
    uint32_t best = vertices[0];
    for (const uint32_t v : vertices)
      if (farness(v) > farness(best)) best = v;
    chosen.push_back(best);
    span.add(points[best]);
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
  const Mat<D> whitening =
      solver.eigenvalues().cwiseSqrt().cwiseInverse().asDiagonal() * solver.eigenvectors().transpose();
  for (const Vec<D>& x : cage.control_vertices()) whitened_.push_back(whitening * x);
  simplex_ = spread_simplex<D>(cage.used_vertices(), whitened_);
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
  Scatter<D> scatter;
  // More points never span less: long rows are mostly settled by their first entries.
  bool spans = false;
  size_t kept = 0, next_look = 8;
  for (RowEntry<D>& entry : row) {
    if (!is_kept(std::abs(entry.value), settings_.gradients ? entry.gradient.norm() : 0.0)) continue;
    if (!spans) scatter.add(whitened_[entry.vertex]);
    std::swap(row[kept++], entry);  // to the front, in order
    if (spans || kept < next_look) continue;
    spans = scatter.spans(kKeptSpanMin);
    next_look *= 2;
  }
  if (spans || scatter.spans(kKeptSpanMin)) return row.resize(kept);
  std::sort(row.begin() + static_cast<std::ptrdiff_t>(kept), row.end(), [](const RowEntry<D>& a, const RowEntry<D>& b) {
    const double of_a = std::abs(a.value), of_b = std::abs(b.value);
    return of_a > of_b || (of_a == of_b && a.vertex < b.vertex);
  });
  // Below this the order is one of rounding errors, and explicit zeros say as much.
  const double negligible = 1e-3 * settings_.prune_below;
  while (kept < row.size() && std::abs(row[kept].value) > negligible && !scatter.spans(kKeptSpanMin))
    scatter.add(whitened_[row[kept++].vertex]);
  row.resize(kept);
  if (!scatter.spans(kKeptSpanMin))
    for (const uint32_t v : simplex_)
      if (std::none_of(row.begin(), row.end(), [&](const RowEntry<D>& entry) { return entry.vertex == v; }))
        row.push_back({v, 0.0, Vec<D>::Zero()});
  std::sort(row.begin(), row.end(), [](const RowEntry<D>& a, const RowEntry<D>& b) { return a.vertex < b.vertex; });
}

// Keeps `influences_max` entries, the largest ones but for those that the others need to span space: scanning
// down, an entry off the span of the kept ones always gets a place, another one only while places are left
// over for the directions that are missing.
template <int D>
void RowFinisher<D>::limit(std::vector<RowEntry<D>>& row) const {
  const size_t places = settings_.influences_max;
  if (places == 0 || row.size() <= places) return;
  std::stable_sort(row.begin(), row.end(),
                   [](const RowEntry<D>& a, const RowEntry<D>& b) { return std::abs(a.value) > std::abs(b.value); });
  AffineSpan<D> span;
  std::vector<RowEntry<D>> kept;
  const auto consider = [&](const RowEntry<D>& entry, double off_span_min) {
    const Vec<D>& x = whitened_[entry.vertex];
    const bool extends = span.distance(x) > off_span_min;
    if (extends) span.add(x);
    if (extends || places - kept.size() > span.missing()) kept.push_back(entry);
  };
  for (auto entry = row.begin(); entry != row.end() && kept.size() < places; ++entry) consider(*entry, kKeptOffSpanMin);
  // Vertices that lie in one plane leave places: the cage's own extremes fill them, farthest first.
  while (span.missing() > 0) {
    const uint32_t farthest = *std::max_element(simplex_.begin(), simplex_.end(), [&](uint32_t a, uint32_t b) {
      return span.distance(whitened_[a]) < span.distance(whitened_[b]);
    });
    const auto in_row =
        std::find_if(row.begin(), row.end(), [&](const RowEntry<D>& entry) { return entry.vertex == farthest; });
    consider(in_row != row.end() ? *in_row : RowEntry<D>{farthest, 0.0, Vec<D>::Zero()}, 0.0);
  }
  std::sort(kept.begin(), kept.end(), [](const RowEntry<D>& a, const RowEntry<D>& b) { return a.vertex < b.vertex; });
  row.swap(kept);
}

// Minimum-norm change of values and gradients that restores linear precision [SBC Eq. 4]. About the mean of the kept
// vertices the constraints of sum and position are orthogonal, so each is met on its own.
template <int D>
double RowFinisher<D>::correct(const Vec<D>& x, std::vector<RowEntry<D>>& row) const {
  // An entry in every row, so that sums run over vectors; memory that Eigen aligns, so that their order is always the
  // same.
  struct Columns {
    Eigen::VectorXd value;
    Eigen::Matrix<double, Eigen::Dynamic, D> vertex, gradient;
  };
  thread_local Columns c;
  const auto count = static_cast<Eigen::Index>(row.size());
  const bool gradients = settings_.gradients;
  c.value.resize(count);
  c.vertex.resize(count, D);
  c.gradient.resize(gradients ? count : 0, D);
  for (Eigen::Index i = 0; i < count; ++i) {
    const RowEntry<D>& entry = row[static_cast<size_t>(i)];
    c.value[i] = entry.value;
    c.vertex.row(i) = cage_.control_vertices()[entry.vertex].transpose();
    if (gradients) c.gradient.row(i) = entry.gradient.transpose();
  }
  const Eigen::Matrix<double, 1, D> mean = c.vertex.colwise().sum() / static_cast<double>(count);
  c.vertex.rowwise() -= mean;
  Mat<D> scatter;
  for (int k = 0; k < D; ++k)
    for (int l = 0; l <= k; ++l) scatter(k, l) = scatter(l, k) = c.vertex.col(k).dot(c.vertex.col(l));
  const Eigen::LDLT<Mat<D>> solver(scatter);
  // The second pass removes what the first one's rounding left; the third only measures.
  for (int pass = 0;; ++pass) {
    const double sum = 1.0 - c.value.sum();
    Vec<D> position = x - mean.transpose();
    for (int k = 0; k < D; ++k) position[k] -= c.value.dot(c.vertex.col(k));
    if (pass == 2) {
      for (Eigen::Index i = 0; i < count; ++i) {
        RowEntry<D>& entry = row[static_cast<size_t>(i)];
        entry.value = c.value[i];
        if (gradients) entry.gradient = c.gradient.row(i).transpose();
      }
      return (position + sum * mean.transpose()).norm() / std::max(1.0, x.norm());
    }
    const Vec<D> position_change = solver.solve(position);
    c.value.array() += sum / static_cast<double>(count);
    for (int k = 0; k < D; ++k) c.value += position_change[k] * c.vertex.col(k);
    if (!gradients) continue;
    Mat<D> jacobian = Mat<D>::Identity();
    Vec<D> gradient_sum;
    for (int k = 0; k < D; ++k) {
      gradient_sum[k] = -c.gradient.col(k).sum();
      for (int l = 0; l < D; ++l) jacobian(k, l) -= c.gradient.col(k).dot(c.vertex.col(l));
    }
    const Mat<D> jacobian_change = solver.solve(jacobian.transpose()).transpose();
    for (int k = 0; k < D; ++k) {
      c.gradient.col(k).array() += gradient_sum[k] / static_cast<double>(count);
      for (int l = 0; l < D; ++l) c.gradient.col(k) += jacobian_change(k, l) * c.vertex.col(l);
    }
  }
}

template <int D>
double RowFinisher<D>::finish(const Vec<D>& x, std::vector<RowEntry<D>>& row) const {
  prune(row);
  limit(row);
  return correct(x, row);
}

template class RowFinisher<2>;
template class RowFinisher<3>;

}  // namespace barycast
