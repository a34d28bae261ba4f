#include <fmt/format.h>

#include <limits>

#include "bind/cost.h"
#include "decode.h"
#include "refusal.h"

namespace barycast::server {
namespace {

template <class Count, class Limit>
Error over_limit(std::string field, Count value, Limit limit, const char* advice) {
  return invalid_argument(std::move(field),
                          fmt::format("{}, more than this server's limit of {}; {}", value, limit, advice));
}

Result<QueryCounts> decode_counts(const v1::QuerySet& queries, const Limits& limits) {
  const QueryCounts counts{queries.point_count(), queries.face_count(), queries.corner_count()};
  const std::string path = "header.queries.";
  if (counts.points == 0) return invalid_argument(path + "point_count", "0; send one query point or more");
  // Indices of points are 32-bit wherever faces name them.
  const uint64_t points_max = std::min<uint64_t>(limits.points_max, std::numeric_limits<uint32_t>::max());
  if (counts.points > points_max) {
    return over_limit(path + "point_count", counts.points, points_max, "cut the points into several requests");
  }
  if (counts.faces > limits.faces_max) {
    return over_limit(path + "face_count", counts.faces, limits.faces_max, "cut the mesh into several requests");
  }
  if (counts.corners > std::numeric_limits<uint32_t>::max()) {
    return over_limit(path + "corner_count", counts.corners, std::numeric_limits<uint32_t>::max(),
                      "cut the mesh into several requests");
  }
  if (counts.corners / 3 < counts.faces || (counts.faces == 0 && counts.corners != 0)) {
    return invalid_argument(path + "corner_count",
                            fmt::format("{} corners for {} faces; a face has 3 or more", counts.corners, counts.faces));
  }
  return counts;
}

template <class Enum>
Error unknown_enum(const std::string& field, Enum value) {
  return invalid_argument(field, fmt::format("unknown value {}; see GetCapabilities", static_cast<int>(value)));
}

Result<Options> decode_options(const v1::ComputeOptions& in, const v1::OutputOptions& output, const Limits& limits) {
  const std::string path = "header.options.";
  Options out;
  switch (in.coordinates()) {
    case v1::COORDINATE_KIND_UNSPECIFIED:
    case v1::COORDINATE_KIND_HARMONIC:
      out.coordinates = CoordinateKind::kHarmonic;
      break;
    case v1::COORDINATE_KIND_MEAN_VALUE:
      out.coordinates = CoordinateKind::kMeanValue;
      break;
    case v1::COORDINATE_KIND_POSITIVE_MEAN_VALUE:
      out.coordinates = CoordinateKind::kPositiveMeanValue;
      break;
    default:
      return unknown_enum(path + "coordinates", in.coordinates());
  }
  switch (in.preset()) {
    case v1::PRESET_UNSPECIFIED:
    case v1::PRESET_DEFAULT:
      out.preset = Preset::kDefault;
      break;
    case v1::PRESET_PAPER:
      out.preset = Preset::kPaper;
      break;
    default:
      return unknown_enum(path + "preset", in.preset());
  }
  switch (in.denoise()) {
    case v1::DENOISE_UNSPECIFIED:
    case v1::DENOISE_AUTO:
      out.denoise = Denoise::kAuto;
      break;
    case v1::DENOISE_NONE:
      out.denoise = Denoise::kNone;
      break;
    case v1::DENOISE_MESH:
      out.denoise = Denoise::kMesh;
      break;
    default:
      return unknown_enum(path + "denoise", in.denoise());
  }
  switch (in.estimator()) {
    case v1::ESTIMATOR_UNSPECIFIED:
      break;
    case v1::ESTIMATOR_SAMPLING:
      out.estimator = Estimator::kSampling;
      break;
    case v1::ESTIMATOR_BOUNDARY_ELEMENT:
      out.estimator = Estimator::kBoundaryElement;
      break;
    case v1::ESTIMATOR_EXACT:
      out.estimator = Estimator::kExact;
      break;
    case v1::ESTIMATOR_PREDICTED:
      out.estimator = Estimator::kPredicted;
      break;
    default:
      return unknown_enum(path + "estimator", in.estimator());
  }
  if (in.has_panels()) out.panels = in.panels();
  if (in.has_samples()) out.samples = in.samples();
  if (in.has_samples() && in.samples() > limits.samples_max) {
    return over_limit(path + "samples", in.samples(), limits.samples_max, "ask for fewer samples");
  }
  out.seed = in.seed();
  if (in.has_thickness()) out.thickness = in.thickness();
  if (in.has_walk_steps_max()) out.walk_steps_max = in.walk_steps_max();
  if (in.has_prune_below()) out.prune_below = in.prune_below();
  if (in.has_smoothing_time()) out.smoothing_time = in.smoothing_time();
  if (in.has_target_error()) out.target_error = in.target_error();
  out.tables = in.tables();
  out.gradients = output.gradients();
  out.influences_max = output.influences_max();
  return out;
}

Status decode_output(const v1::OutputOptions& in, const Limits& limits, ComputePlan& plan) {
  const std::string path = "header.output.";
  switch (in.type()) {
    case v1::DATA_TYPE_UNSPECIFIED:
    case v1::DATA_TYPE_FLOAT32:
      plan.float64 = false;
      break;
    case v1::DATA_TYPE_FLOAT64:
      plan.float64 = true;
      break;
    case v1::DATA_TYPE_UINT32:
      return invalid_argument(path + "type",
                              "DATA_TYPE_UINT32; coordinates are DATA_TYPE_FLOAT32 or DATA_TYPE_FLOAT64");
    default:
      return unknown_enum(path + "type", in.type());
  }
  if (in.block_rows() > limits.block_rows_max) {
    return over_limit(path + "block_rows", in.block_rows(), limits.block_rows_max, "ask for fewer, or 0");
  }
  plan.block_rows = in.block_rows();
  if (in.errors() && plan.options.target_error == 0.0)
    return invalid_argument(path + "errors",
                            "only rows of a target error know theirs; set options.target_error as well");
  plan.errors = in.errors();
  return Done{};
}

// The cage of either message that names one.
template <class Message>
Status decode_cage_choice(const Message& message, const Limits& limits, ComputePlan& plan) {
  if (message.has_inline_cage()) {
    Result<CageStorage> cage = decode_cage(message.inline_cage(), limits);
    if (!cage) return cage.error();
    plan.cage = std::move(*cage);
    return Done{};
  }
  if (!message.has_cage_digest()) return invalid_argument("header", "no cage; set inline_cage or cage_digest");
  Result<CageDigest> named = decode_digest(message.cage_digest(), "header.cage_digest");
  if (!named) return named.error();
  if (plan.digest && *plan.digest != *named) {
    return invalid_argument("header.expected_digest", "differs from header.cage_digest; leave one out");
  }
  plan.digest = *named;
  return Done{};
}

// All but the cage. Small fields first: a cage is copied only for a request that is otherwise sound.
template <class Message>
Result<ComputePlan> decode_choices(const Message& message, const Limits& limits) {
  ComputePlan plan{};
  Result<QueryCounts> counts = decode_counts(message.queries(), limits);
  if (!counts) return counts.error();
  plan.counts = *counts;
  Result<Options> options = decode_options(message.options(), message.output(), limits);
  if (!options) return options.error();
  Result<ResolvedOptions> resolved = resolve(*options, plan.counts.faces > 0);
  if (!resolved) return at_options(resolved.error());
  if (const uint64_t most = samples_most(*resolved); resolved->target_error > 0.0 && most > limits.samples_max) {
    return invalid_argument("header.options.target_error",
                            fmt::format("up to {} samples a point, more than this server's limit of {}; set samples "
                                        "instead",
                                        most, limits.samples_max));
  }
  plan.options = *resolved;
  if (Status s = decode_output(message.output(), limits, plan); !s) return s.error();
  return plan;
}

// Smoothing with a time that differs from the first answer's would join rows of two different fields. A time
// that follows from the mesh is compared later, when it is known.
Status decode_resume(const v1::Resume& resume, ComputePlan& plan) {
  if (resume.first_row() >= plan.counts.points) {
    return invalid_argument("header.resume.first_row",
                            fmt::format("{} >= {} query points", resume.first_row(), plan.counts.points));
  }
  if (resume.numerics_version() != kNumericsVersion) {
    return Error{ErrorCode::kFailedPrecondition, "header.resume.numerics_version",
                 fmt::format("{}, but this server's is {}; rows of both must not be mixed, so start over",
                             resume.numerics_version(), kNumericsVersion)};
  }
  plan.first_row = resume.first_row();
  plan.resumed_smoothing_time = resume.smoothing_time();
  const bool smoothed = plan.options.denoise == Denoise::kMesh;
  if (smoothed && !plan.options.smoothing_time) return Done{};
  return check_resumed_smoothing(plan, smoothed ? *plan.options.smoothing_time : 0.0);
}

}  // namespace

Status check_resumed_smoothing(const ComputePlan& plan, double smoothing_time) {
  if (!plan.resumed_smoothing_time || *plan.resumed_smoothing_time == smoothing_time) return Done{};
  return Error{ErrorCode::kFailedPrecondition, "header.resume.smoothing_time",
               fmt::format("{:.17g}, but these options and faces smooth with {:.17g}; send what the first answer's "
                           "header said, and otherwise the same request",
                           *plan.resumed_smoothing_time, smoothing_time)};
}

Result<ComputePlan> decode_header(const v1::ComputeHeader& header, const Limits& limits) {
  Result<ComputePlan> plan = decode_choices(header, limits);
  if (!plan) return plan;
  if (header.has_resume()) {
    if (Status s = decode_resume(header.resume(), *plan); !s) return s.error();
  }
  if (header.has_expected_digest()) {
    Result<CageDigest> expected = decode_digest(header.expected_digest(), "header.expected_digest");
    if (!expected) return expected.error();
    plan->digest = *expected;
  }
  if (Status s = decode_cage_choice(header, limits, *plan); !s) return s.error();
  return plan;
}

Result<ComputePlan> decode_header(const v1::EstimateCostRequest& request, const Limits& limits) {
  Result<ComputePlan> plan = decode_choices(request, limits);
  if (!plan) return plan;
  if (Status s = decode_cage_choice(request, limits, *plan); !s) return s.error();
  return plan;
}

}  // namespace barycast::server
