#include "cage/digest.h"

#include <bit>
#include <string_view>
#include <vector>

#include "base/sha256.h"

namespace barycast {
namespace {

static_assert(std::endian::native == std::endian::little, "canonical bytes are little-endian");

constexpr std::string_view kMagic = "BCCAGE01";

std::array<uint32_t, 8> counts(const CageInput& input) {
  const auto count = [](size_t entries, size_t per_item) { return static_cast<uint32_t>(entries / per_item); };
  return {static_cast<uint32_t>(input.dimension),
          count(input.control_vertices.size(), static_cast<size_t>(input.dimension)),
          0,
          count(input.segments.size(), 2),
          count(input.triangles.size(), 3),
          count(input.quads.size(), 4),
          input.polygon_offsets.empty() ? 0 : count(input.polygon_offsets.size() - 1, 1),
          count(input.polygon_corners.size(), 1)};
}

}  // namespace

uint64_t canonical_size_bytes(const CageInput& input) {
  return kMagic.size() + 8 * sizeof(uint32_t) + input.control_vertices.size_bytes() + input.segments.size_bytes() +
         input.triangles.size_bytes() + input.quads.size_bytes() + input.polygon_offsets.size_bytes() +
         input.polygon_corners.size_bytes();
}

CageDigest digest(const CageInput& input) {
  Sha256 sha;
  sha.add(kMagic.data(), kMagic.size());
  const auto header = counts(input);
  sha.add(std::span<const uint32_t>(header));
  // -0 and +0 are one position; chunks keep the copy small.
  std::vector<double> chunk;
  for (size_t begin = 0; begin < input.control_vertices.size(); begin += 4096) {
    const auto part =
        input.control_vertices.subspan(begin, std::min<size_t>(4096, input.control_vertices.size() - begin));
    chunk.assign(part.begin(), part.end());
    for (double& value : chunk) value += 0.0;
    sha.add(std::span<const double>(chunk));
  }
  sha.add(input.segments);
  sha.add(input.triangles);
  sha.add(input.quads);
  sha.add(input.polygon_offsets);
  sha.add(input.polygon_corners);
  return {sha.finish(), canonical_size_bytes(input)};
}

std::string hexadecimal(const CageDigest& digest) {
  static constexpr char kDigits[] = "0123456789abcdef";
  std::string text;
  for (const uint8_t byte : digest.sha256) {
    text += kDigits[byte >> 4];
    text += kDigits[byte & 15];
  }
  return text;
}

}  // namespace barycast
