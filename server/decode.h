#pragma once

// Protobuf -> core types. Untrusted data lives above this file; what it returns is complete, of
// consistent shape and within the limits. What only geometry can tell (indices of cage elements,
// degenerate elements, span) is left to `Cage::create`, and per-point rules to QueryAssembler.
//
// Pure functions, thread-safe, linear in the size of their input. Errors carry the path of the field:
// "header..." for the first message of ComputeCoordinates, "cage..." for a cage wherever it came from.
// kInvalidArgument: wrong and stays wrong. kResourceExhausted: a cage over the limit. kUnimplemented:
// elements not built yet. kFailedPrecondition: rows of another numerics_version.

#include <optional>
#include <string>
#include <vector>

#include "barycast/v1/barycast.pb.h"
#include "base/result.h"
#include "bind/options.h"
#include "cage/cage.h"
#include "cage/digest.h"
#include "request_limits.h"

namespace barycast::server {

// Owns the arrays of a cage; `input` borrows them.
struct CageStorage {
  int dimension = 3;
  std::vector<double> control_vertices;  // n x dimension
  std::vector<uint32_t> segments, triangles, quads, polygon_offsets, polygon_corners;

  CageInput input() const;
  uint64_t stencil_max() const;    // as Cage::stencil_max
  uint64_t element_count() const;  // as CageIndex::element_count, where none is degenerate
  uint64_t control_vertex_count() const { return control_vertices.size() / static_cast<uint64_t>(dimension); }
};

Result<CageStorage> decode_cage(const v1::Cage& cage, const Limits& limits);
// The serialized bytes of a Cage message.
Result<CageStorage> decode_cage_bytes(const std::string& bytes, const Limits& limits);

Result<CageDigest> decode_digest(const v1::CageDigest& digest, const std::string& path);
Result<std::vector<CageDigest>> decode_digests(const v1::FindMissingCagesRequest& request, const Limits& limits);

// Announced size of the query set.
struct QueryCounts {
  uint64_t points = 0, faces = 0, corners = 0;
};

// A ComputeHeader, understood.
struct ComputePlan {
  std::optional<CageStorage> cage;   // sent along; otherwise `digest` names it
  std::optional<CageDigest> digest;  // of the cage, as the client believes
  QueryCounts counts;
  ResolvedOptions options;
  bool float64 = false;
  bool errors = false;      // rows say what they are off by
  uint32_t block_rows = 0;  // 0: as fits
  uint64_t first_row = 0;
  std::optional<double> resumed_smoothing_time;  // of a resume: what the first answer said, 0 without denoising
};

Result<ComputePlan> decode_header(const v1::ComputeHeader& header, const Limits& limits);
// The same decisions, with the same paths, about a request that is only priced.
Result<ComputePlan> decode_header(const v1::EstimateCostRequest& request, const Limits& limits);

// `smoothing_time`: what the computation will use. Errors: kFailedPrecondition, a resume that expects another.
Status check_resumed_smoothing(const ComputePlan& plan, double smoothing_time);

}  // namespace barycast::server
