#include "barycast/client/options.h"

#include <array>
#include <utility>

namespace barycast::client {
namespace {

template <class Enum, size_t n>
using Names = std::array<std::pair<Enum, const char*>, n>;

constexpr Names<Coordinates, 3> kCoordinates{{{Coordinates::kHarmonic, "harmonic"},
                                              {Coordinates::kMeanValue, "mean-value"},
                                              {Coordinates::kPositiveMeanValue, "positive-mean-value"}}};
constexpr Names<Preset, 2> kPresets{{{Preset::kDefault, "default"}, {Preset::kPaper, "paper"}}};
constexpr Names<Denoise, 3> kDenoise{{{Denoise::kAuto, "auto"}, {Denoise::kNone, "none"}, {Denoise::kMesh, "mesh"}}};
constexpr Names<DataType, 2> kDataTypes{{{DataType::kFloat32, "float32"}, {DataType::kFloat64, "float64"}}};
constexpr Names<Stage, 4> kStages{{{Stage::kSampling, "sampling"},
                                   {Stage::kSmoothing, "smoothing"},
                                   {Stage::kRows, "rows"},
                                   {Stage::kSolving, "solving"}}};
constexpr Names<Estimator, 5> kEstimators{{{Estimator::kAuto, "auto"},
                                           {Estimator::kSampling, "sampling"},
                                           {Estimator::kBoundaryElement, "boundary-element"},
                                           {Estimator::kExact, "exact"},
                                           {Estimator::kPredicted, "predicted"}}};

template <class Enum, size_t n>
std::string name_in(const Names<Enum, n>& names, Enum value) {
  for (const auto& [known, text] : names) {
    if (known == value) return text;
  }
  return std::to_string(static_cast<int>(value));
}

template <class Enum, size_t n>
std::optional<Enum> named_in(const Names<Enum, n>& names, std::string_view name) {
  for (const auto& [known, text] : names) {
    if (name == text) return known;
  }
  return std::nullopt;
}

}  // namespace

std::string name(Coordinates value) {
  return name_in(kCoordinates, value);
}
std::string name(Preset value) {
  return name_in(kPresets, value);
}
std::string name(Denoise value) {
  return name_in(kDenoise, value);
}
std::string name(DataType value) {
  return name_in(kDataTypes, value);
}
std::string name(Stage value) {
  return name_in(kStages, value);
}
std::string name(Estimator value) {
  return name_in(kEstimators, value);
}

std::optional<Coordinates> coordinates_named(std::string_view name) {
  return named_in(kCoordinates, name);
}
std::optional<Preset> preset_named(std::string_view name) {
  return named_in(kPresets, name);
}
std::optional<Denoise> denoise_named(std::string_view name) {
  return named_in(kDenoise, name);
}
std::optional<DataType> data_type_named(std::string_view name) {
  return named_in(kDataTypes, name);
}
std::optional<Estimator> estimator_named(std::string_view name) {
  return named_in(kEstimators, name);
}

}  // namespace barycast::client
