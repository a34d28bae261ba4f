#pragma once

// What a prediction misses where the walks of a point ended: from its table, and evaluated where that is too rough.

#include <algorithm>
#include <atomic>
#include <span>
#include <vector>

#include "sample/sample.h"
#include "solve/prediction.h"

namespace barycast {

// For one point's walks after another's. Not thread-safe.
class MissingAtEnds {
 public:
  // Calls found(k, missing) for every walk in order, with what is missing at its end times its weight, as many numbers
  // as the prediction has columns. False: `cancel` was seen set.
  template <class Found>
  bool visit(const HarmonicPrediction& prediction, std::span<const Sample<3>> samples, const std::atomic<bool>& cancel,
             const Found& found) {
    for (size_t first = 0; first < samples.size(); first += kAtOnce) {
      if (cancel.load(std::memory_order_relaxed)) return false;
      const auto some = samples.subspan(first, std::min(kAtOnce, samples.size() - first));
      evaluate_rough(prediction, some);
      for (size_t k = 0; k < some.size(); ++k) {
        find(prediction, some[k], k);
        found(first + k, std::span<const double>(missing_));
      }
    }
    return true;
  }

 private:
  // Some milliseconds at most.
  static constexpr size_t kAtOnce = 128;
  static constexpr Eigen::Index kFromTable = -1;

  void evaluate_rough(const HarmonicPrediction& prediction, std::span<const Sample<3>> samples);
  void find(const HarmonicPrediction& prediction, const Sample<3>& sample, size_t k);

  std::vector<Eigen::Index> row_;  // by walk; none where no walk ended where the table is rough
  std::vector<ResidualTable::Node> ends_;
  HarmonicPrediction::Rows::Table rows_;
  std::vector<double> missing_;
};

}  // namespace barycast
