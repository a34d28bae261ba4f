#include "estimate/moment_correction.h"

#include <algorithm>
#include <vector>

namespace barycast {
namespace {

// What is missing may leave less mass than this part of the predicted one only where walks hardly hit.
constexpr double kMassMin = 0.5;
constexpr double kLargePart = 0.25;

}  // namespace

MomentCorrection::MomentCorrection(const BoundaryData& data, const Vec<3>& x, const BoundaryData::Row& predicted)
    : data_(data), x_(x), predicted_(predicted), predicted_values_(data.basis_count()) {
  const MomentProjection projection(data, x, predicted);
  predicted_mass_ = projection.mass();
  predicted_spans_ = projection.spans();
  projection.values(predicted_values_);
}

BoundaryData::Row MomentCorrection::corrected(std::span<const float> missing) const {
  return predicted_ + Eigen::Map<const Eigen::RowVectorXf>(missing.data(), predicted_.size()).cast<double>();
}

MomentCorrection::Outcome MomentCorrection::outcome(const MomentProjection& corrected) const {
  if (corrected.mass() < kMassMin * predicted_mass_) return Outcome::kLittleMass;
  return corrected.spans() ? Outcome::kCorrected : Outcome::kSingular;
}

MomentCorrection::Outcome MomentCorrection::correct(std::span<const float> missing, std::span<float> correction) const {
  const BoundaryData::Row moments = corrected(missing);
  const MomentProjection projection(data_, x_, moments);
  const Outcome outcome = this->outcome(projection);
  if (outcome != Outcome::kCorrected) {
    std::fill(correction.begin(), correction.end(), 0.0f);
    return outcome;
  }
  BoundaryData::Row values(data_.basis_count());
  projection.values(values);
  Eigen::Map<Eigen::RowVectorXf>(correction.data(), values.size()) = (values - predicted_values_).cast<float>();
  return outcome;
}

bool MomentCorrection::is_large(std::span<const float> correction) const {
  const Eigen::Map<const Eigen::RowVectorXf> change(correction.data(), predicted_values_.size());
  const BoundaryData::Row corrected = predicted_values_ + change.cast<double>();
  return double{change.norm()} > kLargePart * corrected.norm();
}

Randomizations::Error MomentCorrection::error(const Randomizations& missing) const {
  const auto columns = static_cast<size_t>(predicted_.size());
  std::vector<float> mean(columns), batch(columns), change(static_cast<size_t>(data_.basis_count()));
  missing.mean(mean);
  const BoundaryData::Row moments = corrected(mean);
  const MomentProjection corrected(data_, x_, moments), predicted(data_, x_, predicted_);
  const MomentProjection& about = outcome(corrected) == Outcome::kCorrected ? corrected : predicted;
  BoundaryData::Row off(predicted_.size()), changed(data_.basis_count());
  Randomizations changes(change.size());
  for (size_t i = 0; i < missing.batch_count(); ++i) {
    missing.batch_mean(i, batch);
    for (size_t k = 0; k < columns; ++k) off[static_cast<Eigen::Index>(k)] = double{batch[k]} - double{mean[k]};
    about.change(Vec<3>::Zero(), off, changed);
    for (size_t v = 0; v < change.size(); ++v) change[v] = static_cast<float>(changed[static_cast<Eigen::Index>(v)]);
    changes.add(change);
  }
  return changes.error();
}

}  // namespace barycast
