#include "estimate/missing_at_ends.h"

namespace barycast {

void MissingAtEnds::evaluate_rough(const HarmonicPrediction& prediction, std::span<const Sample<3>> samples) {
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

void MissingAtEnds::find(const HarmonicPrediction& prediction, const Sample<3>& sample, size_t k) {
  missing_.assign(static_cast<size_t>(prediction.columns()), 0.0);
  if (row_.empty() || row_[k] == kFromTable)
    return prediction.add_missing(sample.element, sample.shares, sample.weight, missing_);
  const auto row = rows_.row(row_[k]);
  for (size_t c = 0; c < missing_.size(); ++c) missing_[c] = sample.weight * double{row[static_cast<Eigen::Index>(c)]};
}

}  // namespace barycast
