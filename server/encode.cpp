#include "encode.h"

#include <cstring>

#include "kinds.h"
#include "request_cost.h"

namespace barycast::server {
namespace {

void set_shape(v1::Array& array, v1::DataType type, size_t rows, uint32_t columns) {
  array.set_type(type);
  array.set_rows(rows);
  array.set_columns(columns);
}

void encode_uint32(const std::vector<uint32_t>& values, v1::Array& array) {
  set_shape(array, v1::DATA_TYPE_UINT32, values.size(), 1);
  array.set_data(values.data(), values.size() * sizeof(uint32_t));
}

void encode_float(const std::vector<double>& values, uint32_t columns, bool float64, v1::Array& array) {
  set_shape(array, float64 ? v1::DATA_TYPE_FLOAT64 : v1::DATA_TYPE_FLOAT32, values.size() / columns, columns);
  if (float64) {
    array.set_data(values.data(), values.size() * sizeof(double));
    return;
  }
  std::string& bytes = *array.mutable_data();
  bytes.resize(values.size() * sizeof(float));
  for (size_t i = 0; i < values.size(); ++i) {
    const auto rounded = static_cast<float>(values[i]);
    std::memcpy(bytes.data() + i * sizeof(float), &rounded, sizeof(float));
  }
}

v1::CoordinateKind encode_kind(CoordinateKind kind) {
  switch (kind) {
    case CoordinateKind::kHarmonic:
      return v1::COORDINATE_KIND_HARMONIC;
    case CoordinateKind::kMeanValue:
      return v1::COORDINATE_KIND_MEAN_VALUE;
    case CoordinateKind::kPositiveMeanValue:
      return v1::COORDINATE_KIND_POSITIVE_MEAN_VALUE;
  }
  return v1::COORDINATE_KIND_UNSPECIFIED;
}

v1::Estimator encode_estimator(Estimator estimator) {
  switch (estimator) {
    case Estimator::kSampling:
      return v1::ESTIMATOR_SAMPLING;
    case Estimator::kBoundaryElement:
      return v1::ESTIMATOR_BOUNDARY_ELEMENT;
    case Estimator::kExact:
      return v1::ESTIMATOR_EXACT;
    case Estimator::kPredicted:
      return v1::ESTIMATOR_PREDICTED;
  }
  return v1::ESTIMATOR_UNSPECIFIED;
}

void encode_options(const ResponseFacts& facts, v1::ComputeOptions& out) {
  const ResolvedOptions& options = facts.options;
  out.set_coordinates(encode_kind(options.coordinates));
  out.set_preset(options.preset == Preset::kPaper ? v1::PRESET_PAPER : v1::PRESET_DEFAULT);
  out.set_estimator(encode_estimator(options.estimator));
  out.set_seed(options.seed);
  out.set_denoise(options.denoise == Denoise::kMesh ? v1::DENOISE_MESH : v1::DENOISE_NONE);
  out.set_prune_below(options.prune_below);
  if (options.estimator == Estimator::kBoundaryElement) out.set_panels(options.panels);
  if (!takes_samples(options.estimator)) return;
  out.set_thickness(options.thickness);
  out.set_walk_steps_max(options.walk_steps_max);
  out.set_tables(options.tables);
  if (options.target_error > 0.0) {
    out.set_target_error(options.target_error);
    return;
  }
  out.set_samples(options.samples);
  out.set_smoothing_time(facts.smoothing_time);
}

v1::Stage encode_stage(Stage stage) {
  switch (stage) {
    case Stage::kSolving:
      return v1::STAGE_SOLVING;
    case Stage::kSampling:
      return v1::STAGE_SAMPLING;
    case Stage::kSmoothing:
      return v1::STAGE_SMOOTHING;
    case Stage::kRows:
      return v1::STAGE_ROWS;
  }
  return v1::STAGE_UNSPECIFIED;
}

}  // namespace

v1::ComputeCoordinatesResponse encode_header(const ResponseFacts& facts) {
  v1::ComputeCoordinatesResponse response;
  v1::ResponseHeader& header = *response.mutable_header();
  *header.mutable_cage_digest() = encode_digest(facts.digest);
  header.set_cage_cache_hit(facts.cage_cache_hit);
  encode_options(facts, *header.mutable_options());
  header.mutable_output()->set_type(facts.float64 ? v1::DATA_TYPE_FLOAT64 : v1::DATA_TYPE_FLOAT32);
  header.mutable_output()->set_gradients(facts.options.gradients);
  header.mutable_output()->set_block_rows(facts.block_rows);
  header.mutable_output()->set_influences_max(facts.options.influences_max);
  header.mutable_output()->set_errors(facts.errors);
  header.set_numerics_version(kNumericsVersion);
  header.set_control_vertex_count(facts.control_vertex_count);
  return response;
}

v1::ComputeCoordinatesResponse encode_progress(const Progress& progress) {
  v1::ComputeCoordinatesResponse response;
  response.mutable_progress()->set_stage(encode_stage(progress.stage));
  response.mutable_progress()->set_done(progress.done);
  response.mutable_progress()->set_total(progress.total);
  return response;
}

v1::ComputeCoordinatesResponse encode_rows(const RowBlock& block, const RowFormat& format) {
  v1::ComputeCoordinatesResponse response;
  v1::RowBlock& rows = *response.mutable_rows();
  rows.set_first_row(block.first_row);
  encode_uint32(block.offsets, *rows.mutable_offsets());
  encode_uint32(block.indices, *rows.mutable_indices());
  encode_float(block.values, 1, format.float64, *rows.mutable_values());
  if (!block.gradients.empty()) {
    encode_float(block.gradients, static_cast<uint32_t>(format.dimension), format.float64, *rows.mutable_gradients());
  }
  rows.set_flags(block.flags.data(), block.flags.size());
  if (format.errors) rows.set_errors(block.errors.data(), block.errors.size() * sizeof(float));
  return response;
}

v1::ComputeCoordinatesResponse encode_summary(const BindingSummary& summary, double cage_s) {
  v1::ComputeCoordinatesResponse response;
  v1::Summary& out = *response.mutable_summary();
  out.set_row_count(summary.rows);
  out.set_entry_count(summary.entries);
  out.set_samples(summary.samples);
  out.set_walk_steps(summary.walk_steps);
  out.set_walks_capped(summary.walks_capped);
  out.set_walks_discarded(summary.walks_discarded);
  out.set_walk_reentries(summary.walk_reentries);
  out.mutable_rows()->set_on_cage(summary.rows_on_cage);
  out.mutable_rows()->set_outside(summary.rows_outside);
  out.mutable_rows()->set_few_samples(summary.rows_few_samples);
  out.mutable_rows()->set_no_samples(summary.rows_no_samples);
  out.mutable_rows()->set_rank_deficient(summary.rows_rank_deficient);
  out.set_rows_above_target(summary.rows_above_target);
  out.set_linear_precision_error_max(summary.linear_precision_error_max);
  const auto add_time = [&out](const char* stage, double seconds) {
    out.add_times()->set_stage(stage);
    out.mutable_times(out.times_size() - 1)->set_seconds(seconds);
  };
  add_time("cage", cage_s);
  add_time("solving", summary.solving_s);
  add_time("sampling", summary.sampling_s);
  add_time("smoothing_factor", summary.smoothing_factor_s);
  add_time("smoothing_solve", summary.smoothing_solve_s);
  add_time("rows", summary.rows_s);
  for (const Warning& warning : summary.warnings) *out.add_warnings() = encode_warning(warning);
  return response;
}

v1::CageDigest encode_digest(const CageDigest& digest) {
  v1::CageDigest result;
  result.set_sha256(digest.sha256.data(), digest.sha256.size());
  result.set_size_bytes(digest.size_bytes);
  return result;
}

v1::Warning encode_warning(const Warning& warning) {
  v1::Warning result;
  result.set_field(warning.field);
  result.set_message(warning.message);
  return result;
}

v1::GetCapabilitiesResponse encode_capabilities(const Limits& limits, const std::string& build_version) {
  v1::GetCapabilitiesResponse response;
  for (const CoordinateKind kind : built_kinds()) response.add_coordinates(encode_kind(kind));
  response.add_presets(v1::PRESET_DEFAULT);
  response.add_presets(v1::PRESET_PAPER);
  for (const v1::Estimator estimator :
       {v1::ESTIMATOR_SAMPLING, v1::ESTIMATOR_BOUNDARY_ELEMENT, v1::ESTIMATOR_EXACT, v1::ESTIMATOR_PREDICTED})
    response.add_estimators(estimator);
  v1::ElementSupport& plane = *response.add_elements();
  plane.set_dimension(2);
  plane.add_kinds("segments");
  v1::ElementSupport& space = *response.add_elements();
  space.set_dimension(3);
  for (const char* kind : {"triangles", "quads", "polygons"}) space.add_kinds(kind);
  v1::Limits& out = *response.mutable_limits();
  out.set_cage_bytes_max(limits.cage_bytes_max);
  out.set_points_max(limits.points_max);
  out.set_faces_max(limits.faces_max);
  out.set_samples_max(limits.samples_max);
  out.set_block_rows_max(limits.block_rows_max);
  out.set_message_bytes_max(limits.message_bytes_max);
  out.set_digests_max(limits.digests_max);
  out.set_request_bytes_max(limits.request_bytes_max);
  response.set_build_version(build_version);
  response.set_numerics_version(kNumericsVersion);
  return response;
}

void encode_cost(const RequestCost& cost, v1::EstimateCostResponse& response) {
  response.set_memory_bytes(cost.memory_bytes);
  response.set_samples(cost.samples);
  response.set_output_bytes(cost.output_bytes);
}

uint64_t entry_bytes(int dimension, bool gradients, bool float64) {
  const uint64_t scalar = float64 ? 8 : 4;
  return 4 + scalar * (1 + (gradients ? static_cast<uint64_t>(dimension) : 0));
}

uint64_t row_bytes(bool errors) {
  return 5 + (errors ? 2 * sizeof(float) : 0);
}

}  // namespace barycast::server
