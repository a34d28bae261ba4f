#include "kinds.h"

namespace barycast::server {

std::vector<CoordinateKind> built_kinds() {
  return {CoordinateKind::kHarmonic, CoordinateKind::kMeanValue, CoordinateKind::kPositiveMeanValue};
}

const char* kind_name(CoordinateKind kind) {
  switch (kind) {
    case CoordinateKind::kHarmonic:
      return "harmonic";
    case CoordinateKind::kMeanValue:
      return "mean value";
    case CoordinateKind::kPositiveMeanValue:
      return "positive mean value";
  }
  return "unknown";
}

}  // namespace barycast::server
