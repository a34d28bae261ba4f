#pragma once

// What to compute and how rows are written; field by field as in barycast/v1/options.proto. Unset
// options follow the preset. Ranges are the server's to check: it names the option at fault. The answer
// (Report::options) has every field that the estimator uses, as the server resolved it.

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace barycast::client {

enum class Coordinates { kHarmonic = 1, kMeanValue = 2, kPositiveMeanValue = 3 };
enum class Preset { kDefault = 1, kPaper = 2 };
enum class Denoise { kAuto = 1, kNone = 2, kMesh = 3 };
enum class DataType { kFloat32 = 1, kFloat64 = 2 };
enum class Stage { kSampling = 1, kSmoothing = 2, kRows = 3, kSolving = 4 };
// kAuto: the best that kind, preset and cage allow; the answer says which.
enum class Estimator { kAuto = 0, kSampling = 1, kBoundaryElement = 2, kExact = 3, kPredicted = 4 };

struct ComputeOptions {
  Coordinates coordinates = Coordinates::kHarmonic;
  Preset preset = Preset::kDefault;
  Estimator estimator = Estimator::kAuto;
  std::optional<uint32_t> samples = {};
  std::optional<uint32_t> panels = {};  // of boundary elements
  uint64_t seed = 0;
  Denoise denoise = Denoise::kAuto;
  std::optional<double> thickness = {};         // in diagonals of the cage's bounding box
  std::optional<uint32_t> walk_steps_max = {};  // longest walk
  std::optional<double> prune_below = {};       // drop smaller coordinates
  std::optional<double> smoothing_time = {};    // in squared diagonals
  // Of predicted coordinates, instead of samples: the standard error that a row's values are to have.
  std::optional<double> target_error = {};
  // Of predicted coordinates: corrections inside a closed cage from tables that the server keeps with the cage.
  bool tables = false;

  DataType type = DataType::kFloat32;  // of values and gradients
  bool gradients = false;              // per unit of the caller's length
  uint32_t block_rows = 0;             // rows per block; 0: the server chooses
  uint32_t influences_max = 0;         // coordinates kept per row; 0: all
  bool errors = false;                 // what rows are off by, with a target error
};

// "mean-value", "paper", "auto", "float32", "sampling"; a value that this client does not know becomes its number.
std::string name(Coordinates value);
std::string name(Preset value);
std::string name(Denoise value);
std::string name(DataType value);
std::string name(Stage value);
std::string name(Estimator value);

// The reverse; nothing where the name is unknown.
std::optional<Coordinates> coordinates_named(std::string_view name);
std::optional<Preset> preset_named(std::string_view name);
std::optional<Denoise> denoise_named(std::string_view name);
std::optional<DataType> data_type_named(std::string_view name);
std::optional<Estimator> estimator_named(std::string_view name);

}  // namespace barycast::client
