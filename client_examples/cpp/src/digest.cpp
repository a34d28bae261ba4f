#include "digest.h"

#include <openssl/evp.h>

#include <bit>
#include <memory>
#include <new>
#include <string_view>

namespace barycast::client {
namespace {

static_assert(std::endian::native == std::endian::little, "canonical bytes are little-endian");

class Sha256 {
 public:
  Sha256() : context_(EVP_MD_CTX_new(), EVP_MD_CTX_free) {
    check(context_ && EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr) == 1);
  }
  void add(const void* data, size_t bytes) {
    check(EVP_DigestUpdate(context_.get(), data, bytes) == 1);
    bytes_ += bytes;
  }
  template <class T>
  void add(std::span<const T> values) {
    add(values.data(), values.size_bytes());
  }
  CageDigest finish() {
    CageDigest result{.size_bytes = bytes_};
    check(EVP_DigestFinal_ex(context_.get(), result.sha256.data(), nullptr) == 1);
    return result;
  }

 private:
  // The hash itself cannot fail; its context can where memory runs out.
  static void check(bool ok) {
    if (!ok) throw std::bad_alloc();
  }

  std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context_;
  uint64_t bytes_ = 0;
};

constexpr std::string_view kMagic = "BCCAGE01";

uint32_t count(size_t entries, size_t per_item = 1) {
  return static_cast<uint32_t>(entries / per_item);
}

}  // namespace

CageDigest digest_of(const CageParts& parts) {
  Sha256 sha;
  sha.add(kMagic.data(), kMagic.size());
  const std::array<uint32_t, 8> head = {parts.dimension,
                                        count(parts.control_vertices.size(), parts.dimension),
                                        0,
                                        count(parts.segments.size(), 2),
                                        count(parts.triangles.size(), 3),
                                        count(parts.quads.size(), 4),
                                        count(parts.polygons.size()),
                                        count(parts.polygons.corners.size())};
  sha.add(std::span<const uint32_t>(head));
  for (const double coordinate : parts.control_vertices) {
    const double positive_zero = coordinate + 0.0;  // -0 becomes +0
    sha.add(&positive_zero, sizeof positive_zero);
  }
  sha.add(std::span<const uint32_t>(parts.segments));
  sha.add(std::span<const uint32_t>(parts.triangles));
  sha.add(std::span<const uint32_t>(parts.quads));
  if (parts.polygons.size() > 0) {
    const std::vector<uint32_t> offsets(parts.polygons.offsets.begin(), parts.polygons.offsets.end());
    sha.add(std::span<const uint32_t>(offsets));
  }
  sha.add(std::span<const uint32_t>(parts.polygons.corners));
  return sha.finish();
}

std::string CageDigest::hexadecimal() const {
  static constexpr char kDigits[] = "0123456789abcdef";
  std::string text;
  for (const uint8_t byte : sha256) {
    text += kDigits[byte >> 4];
    text += kDigits[byte & 15];
  }
  return text;
}

}  // namespace barycast::client
