#include "bind/options.h"

#include <cmath>
#include <string>

#include "base/tolerances.h"
#include "solve/prediction.h"

namespace barycast {
namespace {

constexpr uint32_t kSamplesDefault = 50;    // the paper's default [SBC 6]
constexpr uint32_t kSamplesPredicted = 12;  // to correct a prediction
constexpr double kTargetErrorMin = 1e-5;
constexpr uint32_t kSamplesMax = 10'000'000;  // a service sets its own, lower limit
constexpr uint32_t kWalkStepsPaper = 20;      // [SBC 5.1]
constexpr uint32_t kPanelsDefault = 1000;     // FireHydrant: E 0.0015, half a second on two cores
constexpr uint32_t kPanelsMin = 16;
constexpr uint32_t kPanelsMax = 4000;  // the matrix then has 0.6 GB
// Walks take about ten steps; 300 guards against geometry in which they do not arrive.
constexpr uint32_t kWalkStepsDefault = 300;
constexpr uint32_t kWalkStepsMax = 100'000;

Status check_range(const char* field, double value, double low, double high, const char* text) {
  if (value >= low && value <= high) return Done{};  // false for NaN
  return invalid_argument(field, text);
}

// What an estimator without samples can do, and which choices make no sense with it.
Status check_solved(const Options& options, Estimator estimator) {
  if (options.preset == Preset::kPaper)
    return invalid_argument("estimator", "the paper's preset is sampling; leave one out");
  const bool harmonic = options.coordinates == CoordinateKind::kHarmonic;
  if (estimator == Estimator::kBoundaryElement && !harmonic)
    return invalid_argument("estimator", "boundary elements solve for harmonic coordinates only");
  if (estimator == Estimator::kExact && options.coordinates != CoordinateKind::kMeanValue)
    return invalid_argument("estimator",
                            "exact is the closed form of mean value coordinates; the other kinds have none");
  if (options.samples) return invalid_argument("samples", "this estimator takes no samples; leave them out");
  if (options.walk_steps_max) return invalid_argument("walk_steps_max", "this estimator takes no walks; leave it out");
  if (options.thickness) return invalid_argument("thickness", "this estimator needs none; leave it out");
  if (options.denoise == Denoise::kMesh || options.smoothing_time)
    return invalid_argument("denoise", "this estimator has no noise; leave denoising out");
  return Done{};
}

Status check_target(const Options& options, Estimator estimator) {
  if (!options.target_error) return Done{};
  if (estimator != Estimator::kPredicted)
    return invalid_argument("target_error", "only predicted coordinates are refined to a target; leave it out");
  if (options.samples) return invalid_argument("samples", "a target error decides how many; leave one of them out");
  if (options.denoise == Denoise::kMesh || options.smoothing_time)
    return invalid_argument("denoise", "a target error is met point by point; leave denoising out");
  return check_range("target_error", *options.target_error, kTargetErrorMin, 1.0, "must be 1e-5 to 1");
}

Status check_panels(const Options& options) {
  if (!options.panels) return Done{};
  if (options.estimator != Estimator::kBoundaryElement)
    return invalid_argument("panels", "only boundary elements have panels; leave them out");
  if (*options.panels >= kPanelsMin && *options.panels <= kPanelsMax) return Done{};
  return invalid_argument("panels", "must be 16 to 4000");
}

}  // namespace

Result<ResolvedOptions> resolve(const Options& options, bool queries_have_faces) {
  const bool paper = options.preset == Preset::kPaper, harmonic = options.coordinates == CoordinateKind::kHarmonic;
  const Estimator best = harmonic && !paper ? Estimator::kPredicted : Estimator::kSampling;
  const Estimator estimator = options.estimator.value_or(best);
  const bool predicted = estimator == Estimator::kPredicted, sampling = takes_samples(estimator);
  if (const Status known = check_panels(options); !known) return known.error();
  if (const Status sound = check_target(options, estimator); !sound) return sound.error();
  if (predicted && estimator != best)
    return invalid_argument("estimator", paper ? "the paper's preset predicts nothing; leave one out"
                                               : "only harmonic coordinates are predicted");
  if (options.tables && best != Estimator::kPredicted)
    return invalid_argument("tables", paper ? "tables hold the corrections of a prediction, and the paper's preset "
                                              "predicts nothing; leave them out"
                                            : "tables hold the corrections of a prediction, and only harmonic "
                                              "coordinates are predicted; leave them out");
  if (options.tables && !predicted)
    return invalid_argument("tables",
                            "tables hold the corrections of a prediction; choose that estimator or leave them out");
  if (options.tables && options.target_error)
    return invalid_argument("tables",
                            "what noise tables have nobody knows, so that no target is met by them; leave "
                            "them or target_error out");
  if (const Status fits = sampling ? Status(Done{}) : check_solved(options, estimator); !fits) return fits.error();
  // What only a prediction can do is a choice of it; and leaves no noise to a mesh.
  const bool settled = options.tables || options.target_error, by_default = !options.estimator && !settled;
  ResolvedOptions resolved{
      .coordinates = options.coordinates,
      .preset = options.preset,
      .estimator = estimator,
      .samples = sampling ? options.samples.value_or(predicted ? kSamplesPredicted : kSamplesDefault) : 0,
      .panels = estimator == Estimator::kBoundaryElement ? options.panels.value_or(kPanelsDefault) : 0,
      .seed = options.seed,
      .denoise = options.denoise,
      .thickness = options.thickness.value_or(kThicknessDefault),
      .walk_steps_max = options.walk_steps_max.value_or(paper ? kWalkStepsPaper : kWalkStepsDefault),
      .prune_below = options.prune_below.value_or(paper ? 0.0 : kPruneDefault),
      .smoothing_time = options.smoothing_time,
      .gradients = options.gradients,
      .influences_max = options.influences_max,
      .tables = options.tables,
      .samples_unpredicted = predicted && by_default ? options.samples.value_or(kSamplesDefault) : 0,
      .target_error = options.target_error.value_or(0.0),
  };
  if (options.denoise == Denoise::kAuto)
    resolved.denoise = queries_have_faces && sampling && !settled ? Denoise::kMesh : Denoise::kNone;
  if (resolved.denoise == Denoise::kMesh && !queries_have_faces)
    return invalid_argument("denoise", "denoising over a mesh needs faces between the query points");
  if (sampling && (resolved.samples < 1 || resolved.samples > kSamplesMax))
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

ResolvedOptions settle(const ResolvedOptions& options, int dimension, uint64_t control_vertices,
                       uint64_t surface_triangles) {
  ResolvedOptions settled = options;
  if (options.estimator != Estimator::kPredicted || options.samples_unpredicted == 0) return settled;
  const bool small = HarmonicPrediction::check(surface_triangles, control_vertices).ok();
  if (dimension == 3 && small) return settled;
  settled.estimator = Estimator::kSampling;
  settled.samples = options.samples_unpredicted;
  settled.unpredicted = dimension == 3;
  return settled;
}

Status check_dimension(const ResolvedOptions& options, int dimension) {
  const auto least = static_cast<uint32_t>(dimension) + 1;
  if (options.influences_max == 0 || options.influences_max >= least) return Done{};
  return invalid_argument("influences_max", "must be 0 (no limit) or at least " + std::to_string(least) +
                                                ": fewer control vertices cannot reproduce a position in " +
                                                std::to_string(dimension) + " dimensions");
}

}  // namespace barycast
