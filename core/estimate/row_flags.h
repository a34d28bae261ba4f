#pragma once

// What a row has to say about itself; the same numbers as RowFlag in the API.

#include <cstdint>

namespace barycast {

enum RowFlags : uint8_t {
  kRowOnCage = 1,          // within the thickness: the cage's basis, extended to first order
  kRowOutside = 2,         // generalized winding number below one half in magnitude
  kRowFewSamples = 4,      // fewer than kSamplesFew samples arrived, and there was no prediction to correct
  kRowNoSamples = 8,       // none arrived: the affine least-squares row, or the prediction alone
  kRowRankDeficient = 16,  // the moment matrix was singular: pseudo-samples stepped in, or a direction was left out
};

}  // namespace barycast
