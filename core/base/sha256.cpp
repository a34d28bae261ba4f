#include "base/sha256.h"

#include <openssl/evp.h>

#include "base/check.h"

namespace barycast {

Sha256::Sha256() : context_(EVP_MD_CTX_new(), EVP_MD_CTX_free) {
  BARYCAST_CHECK(context_ && EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr) == 1);
}

void Sha256::add(const void* data, size_t bytes) {
  BARYCAST_CHECK(EVP_DigestUpdate(context_.get(), data, bytes) == 1);
}

Sha256Digest Sha256::finish() {
  Sha256Digest result{};
  BARYCAST_CHECK(EVP_DigestFinal_ex(context_.get(), result.data(), nullptr) == 1);
  return result;
}

}  // namespace barycast
