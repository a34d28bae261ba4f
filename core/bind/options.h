#pragma once

// What to compute: the caller's choices, and the same with every field decided. Unset choices follow
// the preset. `resolve` is the only way to a ResolvedOptions.

#include <cstdint>
#include <optional>

#include "base/result.h"

namespace barycast {

// Bits of rows may change between versions; rows of different versions are never mixed.
inline constexpr uint32_t kNumericsVersion = 2;

enum class CoordinateKind { kHarmonic, kMeanValue, kPositiveMeanValue };
enum class Preset { kDefault, kPaper };
enum class Denoise { kAuto, kNone, kMesh };

struct Options {
  CoordinateKind coordinates = CoordinateKind::kHarmonic;
  Preset preset = Preset::kDefault;
  std::optional<uint32_t> samples;
  uint64_t seed = 0;
  Denoise denoise = Denoise::kAuto;
  std::optional<double> thickness;  // in diagonals of the cage's bounding box
  std::optional<uint32_t> walk_steps_max;
  std::optional<double> prune_below;
  std::optional<double> smoothing_time;  // in squared diagonals
  bool gradients = false;
  uint32_t influences_max = 0;  // entries of a row; 0: no limit
};

struct ResolvedOptions {
  CoordinateKind coordinates;
  Preset preset;
  uint32_t samples;
  uint64_t seed;
  Denoise denoise;  // kNone or kMesh
  double thickness;
  uint32_t walk_steps_max;
  double prune_below;
  std::optional<double> smoothing_time;  // unset: Binding decides from the query mesh
  bool gradients;
  uint32_t influences_max;
};

// Errors, with paths relative to the options ("samples", "thickness", ...): kInvalidArgument (out of
// range, denoising over a mesh without faces).
Result<ResolvedOptions> resolve(const Options& options, bool queries_have_faces);

// What only the cage's dimension can tell. Errors: kInvalidArgument (influences_max below d + 1: rows could
// not reproduce position).
Status check_dimension(const ResolvedOptions& options, int dimension);

}  // namespace barycast
