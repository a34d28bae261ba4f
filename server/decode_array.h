#pragma once

// The one place that turns the bytes of an API Array into numbers. Every read checks type, columns and
// size first, so a truncated or inconsistent array is refused with its path and nothing is copied.
// Copies once (protobuf bytes have no alignment); float32 is widened. Internal to decode.

#include <string>
#include <vector>

#include "barycast/v1/cage.pb.h"
#include "base/result.h"

namespace barycast::server {

// rows x columns numbers, appended to `out`. `columns` 0: any (the caller checks).
// Errors: kInvalidArgument at path, path.type, path.columns or path.data.
Status append_uint32(const v1::Array& array, uint32_t columns, const std::string& path, std::vector<uint32_t>& out);
Status append_float(const v1::Array& array, uint32_t columns, const std::string& path, std::vector<double>& out);

}  // namespace barycast::server
