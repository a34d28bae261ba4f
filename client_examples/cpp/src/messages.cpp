#include "messages.h"

#include <algorithm>
#include <bit>
#include <cstring>

namespace barycast::client {
namespace {

static_assert(std::endian::native == std::endian::little, "arrays are little-endian");

template <class T>
void fill(v1::Array& array, v1::DataType type, std::span<const T> values, uint32_t columns) {
  array.set_type(type);
  array.set_rows(values.size() / columns);
  array.set_columns(columns);
  array.set_data(values.data(), values.size_bytes());
}

// Only where there are any, as the API asks.
void fill_elements(const std::vector<uint32_t>& corners, uint32_t columns, v1::Array& array) {
  fill(array, v1::DATA_TYPE_UINT32, std::span(corners), columns);
}

template <class T>
bool read(const v1::Array& array, v1::DataType type, uint64_t rows, uint32_t columns, std::vector<T>& values) {
  // Divided, so that no product of announced sizes can overflow.
  const std::string& data = array.data();
  if (array.type() != type || array.rows() != rows || array.columns() != columns) return false;
  if (data.size() % (sizeof(T) * columns) != 0 || data.size() / (sizeof(T) * columns) != rows) return false;
  values.resize(data.size() / sizeof(T));
  if (!data.empty()) std::memcpy(values.data(), data.data(), data.size());
  return true;
}

bool read_reals(const v1::Array& array, v1::DataType type, uint64_t rows, uint32_t columns, Reals& reals) {
  if (type == v1::DATA_TYPE_FLOAT64) return read(array, type, rows, columns, reals.emplace<std::vector<double>>());
  return read(array, type, rows, columns, reals.emplace<std::vector<float>>());
}

std::vector<Warning> warnings(const google::protobuf::RepeatedPtrField<v1::Warning>& messages) {
  std::vector<Warning> result;
  for (const v1::Warning& warning : messages) result.push_back({warning.field(), warning.message()});
  return result;
}

ComputeOptions from_message(const v1::ComputeOptions& options, const v1::OutputOptions& output) {
  return {.coordinates = static_cast<Coordinates>(options.coordinates()),
          .preset = static_cast<Preset>(options.preset()),
          .estimator = static_cast<Estimator>(options.estimator()),
          .samples = options.samples(),
          .panels = options.panels(),
          .seed = options.seed(),
          .denoise = static_cast<Denoise>(options.denoise()),
          .thickness = options.thickness(),
          .walk_steps_max = options.walk_steps_max(),
          .prune_below = options.prune_below(),
          .smoothing_time = options.smoothing_time(),
          .target_error = options.target_error(),
          .tables = options.tables(),
          .type = static_cast<DataType>(output.type()),
          .gradients = output.gradients(),
          .block_rows = output.block_rows(),
          .influences_max = output.influences_max(),
          .errors = output.errors()};
}

}  // namespace

void set_array(v1::Array& array, std::span<const double> values, uint32_t columns) {
  fill(array, v1::DATA_TYPE_FLOAT64, values, columns);
}

void set_array(v1::Array& array, std::span<const float> values, uint32_t columns) {
  fill(array, v1::DATA_TYPE_FLOAT32, values, columns);
}

void set_array(v1::Array& array, std::span<const uint32_t> values, uint32_t columns) {
  fill(array, v1::DATA_TYPE_UINT32, values, columns);
}

v1::Cage to_message(const Cage& cage) {
  const CageParts& parts = cage.parts();
  v1::Cage message;
  set_array(*message.mutable_control_vertices(), std::span<const double>(parts.control_vertices), parts.dimension);
  if (!parts.segments.empty()) fill_elements(parts.segments, 2, *message.mutable_segments());
  if (!parts.triangles.empty()) fill_elements(parts.triangles, 3, *message.mutable_triangles());
  if (!parts.quads.empty()) fill_elements(parts.quads, 4, *message.mutable_quads());
  if (parts.polygons.size() > 0) {
    const std::vector<uint32_t> offsets(parts.polygons.offsets.begin(), parts.polygons.offsets.end());
    fill_elements(offsets, 1, *message.mutable_polygons()->mutable_offsets());
    fill_elements(parts.polygons.corners, 1, *message.mutable_polygons()->mutable_corners());
  }
  return message;
}

v1::CageDigest to_message(const CageDigest& digest) {
  v1::CageDigest message;
  message.set_sha256(digest.sha256.data(), digest.sha256.size());
  message.set_size_bytes(digest.size_bytes);
  return message;
}

v1::ComputeOptions to_message(const ComputeOptions& options) {
  v1::ComputeOptions message;
  message.set_coordinates(static_cast<v1::CoordinateKind>(options.coordinates));
  message.set_preset(static_cast<v1::Preset>(options.preset));
  message.set_seed(options.seed);
  message.set_denoise(static_cast<v1::Denoise>(options.denoise));
  message.set_estimator(static_cast<v1::Estimator>(options.estimator));
  if (options.samples) message.set_samples(*options.samples);
  if (options.panels) message.set_panels(*options.panels);
  if (options.thickness) message.set_thickness(*options.thickness);
  if (options.walk_steps_max) message.set_walk_steps_max(*options.walk_steps_max);
  if (options.prune_below) message.set_prune_below(*options.prune_below);
  if (options.smoothing_time) message.set_smoothing_time(*options.smoothing_time);
  if (options.target_error) message.set_target_error(*options.target_error);
  message.set_tables(options.tables);
  return message;
}

v1::OutputOptions output_message(const ComputeOptions& options) {
  v1::OutputOptions message;
  message.set_type(static_cast<v1::DataType>(options.type));
  message.set_gradients(options.gradients);
  message.set_block_rows(options.block_rows);
  message.set_influences_max(options.influences_max);
  message.set_errors(options.errors);
  return message;
}

Capabilities from_message(const v1::GetCapabilitiesResponse& response) {
  const v1::Limits& limits = response.limits();
  Capabilities result;
  for (const int kind : response.coordinates()) result.coordinates.push_back(static_cast<Coordinates>(kind));
  for (const int preset : response.presets()) result.presets.push_back(static_cast<Preset>(preset));
  for (const int estimator : response.estimators()) result.estimators.push_back(static_cast<Estimator>(estimator));
  result.build_version = response.build_version();
  result.numerics_version = response.numerics_version();
  result.cage_bytes_max = limits.cage_bytes_max();
  result.points_max = limits.points_max();
  result.faces_max = limits.faces_max();
  result.samples_max = limits.samples_max();
  result.block_rows_max = limits.block_rows_max();
  result.message_bytes_max = limits.message_bytes_max();
  result.request_bytes_max = limits.request_bytes_max();
  return result;
}

Result<RowBlock> from_message(const v1::RowBlock& message, const v1::ResponseHeader& header, uint32_t dimension) {
  const Error misfit{Code::kDataLoss, "rows", "the arrays of a block of rows do not fit together"};
  const v1::DataType type = header.output().type();
  RowBlock block;
  block.first_row = message.first_row();
  block.flags.assign(message.flags().begin(), message.flags().end());
  const uint64_t rows = block.flags.size();
  const uint64_t entries = message.indices().rows();
  bool fits = read(message.offsets(), v1::DATA_TYPE_UINT32, rows + 1, 1, block.offsets) &&
              read(message.indices(), v1::DATA_TYPE_UINT32, entries, 1, block.indices) &&
              read_reals(message.values(), type, entries, 1, block.values);
  if (fits && header.output().gradients()) {
    // A block without entries may leave the array out.
    fits = (entries == 0 && message.gradients().data().empty()) ||
           read_reals(message.gradients(), type, entries, dimension, block.gradients);
  }
  const std::string& errors = message.errors();
  fits = fits && errors.size() == (header.output().errors() ? 2 * sizeof(float) * rows : 0);
  if (fits && !errors.empty()) {
    block.errors.resize(2 * rows);
    std::memcpy(block.errors.data(), errors.data(), errors.size());
  }
  if (!fits || block.offsets.front() != 0 || block.offsets.back() != entries ||
      !std::is_sorted(block.offsets.begin(), block.offsets.end())) {
    return misfit;
  }
  const auto beyond = [&](uint32_t index) { return index >= header.control_vertex_count(); };
  if (std::any_of(block.indices.begin(), block.indices.end(), beyond)) return misfit;
  return block;
}

Uploaded from_message(const v1::UploadCageResponse& response) {
  Uploaded result;
  const std::string& sha256 = response.digest().sha256();
  if (sha256.size() == result.digest.sha256.size()) {
    std::memcpy(result.digest.sha256.data(), sha256.data(), sha256.size());
  }
  result.digest.size_bytes = response.digest().size_bytes();
  result.warnings = warnings(response.warnings());
  result.tables = response.tables();
  return result;
}

Report make_report(const v1::ResponseHeader& header, const v1::Summary& summary, uint32_t dimension) {
  Report report;
  report.dimension = dimension;
  report.points = summary.row_count();
  report.control_vertices = header.control_vertex_count();
  report.entries = summary.entry_count();
  report.options = from_message(header.options(), header.output());
  const v1::RowCounts& rows = summary.rows();
  report.rows = {rows.on_cage(), rows.outside(), rows.few_samples(), rows.no_samples(), rows.rank_deficient()};
  report.samples = summary.samples();
  report.walk_steps = summary.walk_steps();
  report.walks_capped = summary.walks_capped();
  report.walks_discarded = summary.walks_discarded();
  report.walk_reentries = summary.walk_reentries();
  report.rows_above_target = summary.rows_above_target();
  report.linear_precision_error_max = summary.linear_precision_error_max();
  for (const v1::StageTime& time : summary.times()) report.seconds.emplace_back(time.stage(), time.seconds());
  report.cage_cache_hit = header.cage_cache_hit();
  report.numerics_version = header.numerics_version();
  report.warnings = warnings(summary.warnings());
  return report;
}

}  // namespace barycast::client
