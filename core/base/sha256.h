#pragma once

// SHA-256 of bytes that come in pieces.

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

struct evp_md_ctx_st;

namespace barycast {

using Sha256Digest = std::array<uint8_t, 32>;

class Sha256 {
 public:
  Sha256();
  void add(const void* data, size_t bytes);
  template <class T>
  void add(std::span<const T> values) {
    add(values.data(), values.size_bytes());
  }
  Sha256Digest finish();

 private:
  std::unique_ptr<evp_md_ctx_st, void (*)(evp_md_ctx_st*)> context_;
};

}  // namespace barycast
