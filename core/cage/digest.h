#pragma once

// The name of a cage: SHA-256 over its canonical bytes, as defined in proto/barycast/v1/cage.proto.
// Defined for any input whose spans are readable, valid cage or not. Thread-safe. Linear in the input.

#include <array>
#include <compare>
#include <cstdint>
#include <string>

#include "cage/cage.h"

namespace barycast {

struct CageDigest {
  std::array<uint8_t, 32> sha256{};
  uint64_t size_bytes = 0;  // number of canonical bytes
  auto operator<=>(const CageDigest&) const = default;
};

CageDigest digest(const CageInput& input);

// Number of canonical bytes, without reading them.
uint64_t canonical_size_bytes(const CageInput& input);

// 64 lower-case hexadecimal digits.
std::string hexadecimal(const CageDigest& digest);

}  // namespace barycast
