#include "kinds.h"

namespace barycast::server {

std::vector<CoordinateKind> built_kinds() {
  std::vector<CoordinateKind> kinds;
  for (const CoordinateKind kind :
       {CoordinateKind::kHarmonic, CoordinateKind::kMeanValue, CoordinateKind::kPositiveMeanValue}) {
    Options options;
    options.coordinates = kind;
    if (resolve(options, false).ok()) kinds.push_back(kind);
  }
  return kinds;
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
