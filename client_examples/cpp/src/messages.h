#pragma once

// Between this library's types and the API's messages; the only place that knows both. Free of gRPC.

#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "barycast/client/client.h"
#include "barycast/v1/barycast.pb.h"

namespace barycast::client {

v1::Cage to_message(const Cage& cage);
v1::CageDigest to_message(const CageDigest& digest);
v1::ComputeOptions to_message(const ComputeOptions& options);
v1::OutputOptions output_message(const ComputeOptions& options);

void set_array(v1::Array& array, std::span<const double> values, uint32_t columns);
void set_array(v1::Array& array, std::span<const float> values, uint32_t columns);
void set_array(v1::Array& array, std::span<const uint32_t> values, uint32_t columns = 1);

Capabilities from_message(const v1::GetCapabilitiesResponse& response);
// Errors: arrays whose types, sizes or counts do not fit together, or indices beyond the control vertices.
Result<RowBlock> from_message(const v1::RowBlock& block, const v1::ResponseHeader& header, uint32_t dimension);
Uploaded from_message(const v1::UploadCageResponse& response);
// Everything that header and summary say; the counts of rows are the caller's to correct after a resume.
Report make_report(const v1::ResponseHeader& header, const v1::Summary& summary, uint32_t dimension);

}  // namespace barycast::client
