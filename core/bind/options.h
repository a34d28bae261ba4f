#pragma once

// What to compute: the caller's choices, and the same with every field decided. Unset choices follow
// the preset. `resolve` is the only way to a ResolvedOptions.

#include <cstdint>
#include <optional>

#include "base/result.h"

namespace barycast {

// Bits of rows may change between versions; rows of different versions are never mixed.
inline constexpr uint32_t kNumericsVersion = 15;

enum class CoordinateKind { kHarmonic, kMeanValue, kPositiveMeanValue };
enum class Preset { kDefault, kPaper };
// How coordinates are found. Sampling suits every cage; the others refuse cages they cannot do.
enum class Estimator {
  kSampling,
  kPredicted,        // harmonic, surface cages in space: walks correct a prediction (estimate/corrected_estimator.h)
  kBoundaryElement,  // harmonic, surface cages in space (solve/boundary_elements.h)
  kExact,            // mean value in closed form, closed triangle cages (solve/exact_mean_value.h)
};
// Walks or rays.
constexpr bool takes_samples(Estimator estimator) {
  return estimator == Estimator::kSampling || estimator == Estimator::kPredicted;
}
enum class Denoise { kAuto, kNone, kMesh };

struct Options {
  CoordinateKind coordinates = CoordinateKind::kHarmonic;
  Preset preset = Preset::kDefault;
  std::optional<Estimator> estimator = {};  // unset: the best that the kind, the preset and the cage allow
  std::optional<uint32_t> samples = {};
  std::optional<uint32_t> panels = {};  // of the boundary elements, at most
  uint64_t seed = 0;
  Denoise denoise = Denoise::kAuto;
  std::optional<double> thickness = {};  // in diagonals of the cage's bounding box
  std::optional<uint32_t> walk_steps_max = {};
  std::optional<double> prune_below = {};
  std::optional<double> smoothing_time = {};  // in squared diagonals
  bool gradients = false;
  uint32_t influences_max = 0;  // entries of a row; 0: no limit
  // Of predicted coordinates, instead of a number of walks: sqrt of the sum over control vertices of the variances of a
  // row's values. Of noise alone, not of bias.
  std::optional<double> target_error = {};
  // With a prediction: corrections inside a closed cage from tables of the cage (estimate/ball_tables.h), for points
  // that follow one another over time. The tables are a function of the cage alone, at the default thickness: samples,
  // seed, thickness and walk_steps_max are left to the points that they do not serve, nearer to the cage than 0.009
  // diagonals or not inside of it. Rows need no denoising over a mesh.
  bool tables = false;
};

struct ResolvedOptions {
  CoordinateKind coordinates;
  Preset preset;
  Estimator estimator;
  uint32_t samples;  // 0 without samples
  uint32_t panels;   // 0 without boundary elements
  uint64_t seed;
  Denoise denoise;  // kNone or kMesh
  double thickness;
  uint32_t walk_steps_max;
  double prune_below;
  std::optional<double> smoothing_time = {};  // unset: Binding decides from the query mesh
  bool gradients;
  uint32_t influences_max;
  bool tables;
  // kPredicted was not asked for: it gives way to so many samples where the cage is not one for it. 0: asked for.
  uint32_t samples_unpredicted = 0;
  bool unpredicted = false;   // and did, for the cage is too large
  double target_error = 0.0;  // 0: none; otherwise `samples` are walks of a round
};

// Errors, with paths relative to the options ("samples", "thickness", ...): kInvalidArgument (out of
// range, denoising over a mesh without faces, choices that do not go together).
Result<ResolvedOptions> resolve(const Options& options, bool queries_have_faces);

// What only the cage can tell: whether harmonic coordinates are predicted where the caller has no choice of his own.
// Calling it again changes nothing. surface_triangles: of cage.h.
ResolvedOptions settle(const ResolvedOptions& options, int dimension, uint64_t control_vertices,
                       uint64_t surface_triangles);

// What only the cage's dimension can tell. Errors: kInvalidArgument (influences_max below d + 1: rows could
// not reproduce position).
Status check_dimension(const ResolvedOptions& options, int dimension);

}  // namespace barycast
