#pragma once

// The correction of a point where moments are predicted, outside and for open cages: walks find what is missing in the
// moments, and coordinates are corrected by what that changes in their projection [SBC Eq. 7 to 10]. That is not linear
// in the moments: of several randomizations the moments are averaged, not the corrections.

#include <span>

#include "estimate/error_estimate.h"
#include "solve/moment_field.h"

namespace barycast {

class MomentCorrection {
 public:
  // `predicted`: columns of the data, at x (normalized frame). Both must outlive the correction.
  MomentCorrection(const BoundaryData& data, const Vec<3>& x, const BoundaryData::Row& predicted);

  // Whether the predicted moments span space.
  bool predicted_spans() const { return predicted_spans_; }
  // Writes what the missing moments change the coordinates by; zeros where it cannot.
  enum class Outcome {
    kCorrected,
    kLittleMass,  // they leave so little that walks hardly hit: the prediction alone is better
    kSingular,    // they leave moments that do not span space
  };
  Outcome correct(std::span<const float> missing, std::span<float> correction) const;
  // Whether such a correction is so large, beside the coordinates, that it may be noise.
  bool is_large(std::span<const float> correction) const;
  // What the coordinates are without it.
  const BoundaryData::Row& predicted_values() const { return predicted_values_; }
  // How far the correction by the mean of what is missing is off, to first order in the moments.
  Randomizations::Error error(const Randomizations& missing) const;

 private:
  BoundaryData::Row corrected(std::span<const float> missing) const;
  Outcome outcome(const MomentProjection& corrected) const;

  const BoundaryData& data_;
  Vec<3> x_;
  const BoundaryData::Row& predicted_;
  double predicted_mass_;
  bool predicted_spans_;
  BoundaryData::Row predicted_values_;
};

}  // namespace barycast
