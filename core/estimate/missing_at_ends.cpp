#include "estimate/missing_at_ends.h"

namespace barycast {

void MissingAtEnds::find(const HarmonicPrediction& prediction, std::span<const Sample<3>> samples) {
  prediction_ = &prediction;
  samples_ = samples;
  row_.clear();
  if (!prediction.has_rough()) return;
  ends_.clear();
  for (const Sample<3>& sample : samples) {
    const bool rough = prediction.is_rough(sample.element, sample.shares);
    row_.push_back(rough ? static_cast<Eigen::Index>(ends_.size()) : kFromTable);
    if (rough) ends_.push_back({sample.element, sample.shares});
  }
  if (ends_.empty()) return row_.clear();
  prediction.evaluate_missing(ends_, rows_);
}

void MissingAtEnds::add(size_t k, std::span<double> sums) const {
  const Sample<3>& sample = samples_[k];
  if (row_.empty() || row_[k] == kFromTable)
    return prediction_->add_missing(sample.element, sample.shares, sample.weight, sums);
  const auto found = rows_.row(row_[k]);
  for (size_t c = 0; c < sums.size(); ++c) sums[c] += sample.weight * double{found[static_cast<Eigen::Index>(c)]};
}

}  // namespace barycast
