#pragma once

// Core types -> protobuf. Rows are written in one pass, rounded to the output type on the way.
// Pure functions, thread-safe, linear in their input.

#include <string>

#include "barycast/v1/barycast.pb.h"
#include "bind/binding.h"
#include "cage/digest.h"
#include "request_limits.h"

namespace barycast::server {

// What the header of an answer states.
struct ResponseFacts {
  CageDigest digest;
  bool cage_cache_hit = false;
  ResolvedOptions options;
  double smoothing_time = 0.0;
  bool float64 = false;
  bool errors = false;
  uint32_t block_rows = 0;
  uint32_t control_vertex_count = 0;
};

v1::ComputeCoordinatesResponse encode_header(const ResponseFacts& facts);
v1::ComputeCoordinatesResponse encode_progress(const Progress& progress);
// How rows are written.
struct RowFormat {
  int dimension = 3;
  bool float64 = false;
  bool errors = false;  // with what they are off by
};
v1::ComputeCoordinatesResponse encode_rows(const RowBlock& block, const RowFormat& format);
// `cage_s`: wall time from the lookup of the cage to its index.
v1::ComputeCoordinatesResponse encode_summary(const BindingSummary& summary, double cage_s);

v1::CageDigest encode_digest(const CageDigest& digest);
v1::Warning encode_warning(const Warning& warning);
struct RequestCost;
void encode_cost(const RequestCost& cost, v1::EstimateCostResponse& response);
v1::GetCapabilitiesResponse encode_capabilities(const Limits& limits, const std::string& build_version);

// Bytes of one entry of a row: index, value, gradient.
uint64_t entry_bytes(int dimension, bool gradients, bool float64);
// Bytes of a row that has no entries: offset, flags, errors.
uint64_t row_bytes(bool errors);

}  // namespace barycast::server
