#include "bind/options.h"

#include <cmath>
#include <string>

#include "base/tolerances.h"

namespace barycast {
namespace {

constexpr uint32_t kSamplesDefault = 50;      // the paper's default [SBC 6]
constexpr uint32_t kSamplesMax = 10'000'000;  // a service sets its own, lower limit
constexpr uint32_t kWalkStepsPaper = 20;      // [SBC 5.1]
// Walks take about ten steps; 300 guards against geometry in which they do not arrive.
constexpr uint32_t kWalkStepsDefault = 300;
constexpr uint32_t kWalkStepsMax = 100'000;

Status check_range(const char* field, double value, double low, double high, const char* text) {
  if (value >= low && value <= high) return Done{};  // false for NaN
  return invalid_argument(field, text);
}

}  // namespace

Result<ResolvedOptions> resolve(const Options& options, bool queries_have_faces) {
  const bool paper = options.preset == Preset::kPaper;
  ResolvedOptions resolved{
      .coordinates = options.coordinates,
      .preset = options.preset,
      .samples = options.samples.value_or(kSamplesDefault),
      .seed = options.seed,
      .denoise = options.denoise,
      .thickness = options.thickness.value_or(kThicknessDefault),
      .walk_steps_max = options.walk_steps_max.value_or(paper ? kWalkStepsPaper : kWalkStepsDefault),
      .prune_below = options.prune_below.value_or(paper ? 0.0 : kPruneDefault),
      .smoothing_time = options.smoothing_time,
      .gradients = options.gradients,
      .influences_max = options.influences_max,
  };
  if (options.denoise == Denoise::kAuto) resolved.denoise = queries_have_faces ? Denoise::kMesh : Denoise::kNone;
  if (resolved.denoise == Denoise::kMesh && !queries_have_faces)
    return invalid_argument("denoise", "denoising over a mesh needs faces between the query points");
  if (resolved.samples < 1 || resolved.samples > kSamplesMax)
    return invalid_argument("samples", resolved.samples < 1 ? "must be 1 or more" : "must be at most 10000000");
  if (resolved.walk_steps_max < 1 || resolved.walk_steps_max > kWalkStepsMax)
    return invalid_argument("walk_steps_max", "must be 1 to 100000");
  if (auto s = check_range("thickness", resolved.thickness, kThicknessMin, kThicknessMax,
                           "must be 1e-6 to 1e-1, in diagonals of the cage's bounding box");
      !s)
    return s.error();
  if (auto s = check_range("prune_below", resolved.prune_below, 0.0, kPruneMax, "must be 0 to 0.1"); !s)
    return s.error();
  if (resolved.smoothing_time)
    if (auto s =
            check_range("smoothing_time", *resolved.smoothing_time, 0.0, 1e6, "must be 0 to 1e6 squared diagonals");
        !s)
      return s.error();
  return resolved;
}

Status check_dimension(const ResolvedOptions& options, int dimension) {
  const auto least = static_cast<uint32_t>(dimension) + 1;
  if (options.influences_max == 0 || options.influences_max >= least) return Done{};
  return invalid_argument("influences_max", "must be 0 (no limit) or at least " + std::to_string(least) +
                                                ": fewer control vertices cannot reproduce a position in " +
                                                std::to_string(dimension) + " dimensions");
}

}  // namespace barycast
