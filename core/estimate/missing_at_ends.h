#pragma once

// What a prediction misses where the walks of a point ended: from its table, and evaluated where that is too rough.

#include <span>
#include <vector>

#include "sample/sample.h"
#include "solve/prediction.h"

namespace barycast {

// For one point's walks after another's. Not thread-safe.
class MissingAtEnds {
 public:
  void find(const HarmonicPrediction& prediction, std::span<const Sample<3>> samples);

  // Adds what is missing at the end of walk k, times its weight, to as many sums as the prediction has columns.
  void add(size_t k, std::span<double> sums) const;

 private:
  static constexpr Eigen::Index kFromTable = -1;

  const HarmonicPrediction* prediction_ = nullptr;
  std::span<const Sample<3>> samples_;
  std::vector<Eigen::Index> row_;  // by walk; none where no walk ended where the table is rough
  std::vector<ResidualTable::Node> ends_;
  HarmonicPrediction::Rows::Table rows_;
};

}  // namespace barycast
