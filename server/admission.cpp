#include "admission.h"

#include <fmt/format.h>

namespace barycast::server {
namespace {

// Most requests last about a second; clients add jitter of their own.
constexpr uint32_t kRetryAfterMs = 1000;

Refusal busy(std::string message) {
  return {.error = {ErrorCode::kResourceExhausted, "", std::move(message)},
          .missing_digest = std::nullopt,
          .retry_after_ms = kRetryAfterMs};
}

}  // namespace

std::variant<std::unique_ptr<Admission::Ticket>, Refusal> Admission::enter(uint64_t bytes) {
  {
    const std::lock_guard lock(mutex_);
    if (requests_ >= bounds_.requests_max) {
      return busy(fmt::format("busy with {} requests; try again later", requests_));
    }
    // A request alone is always admitted: request_bytes_max has judged it by itself.
    if (requests_ > 0 && bytes > bounds_.bytes_max - std::min(bytes_, bounds_.bytes_max)) {
      return busy(fmt::format(
          "busy: {} bytes of working memory are promised and this request needs {}; try again later", bytes_, bytes));
    }
    ++requests_;
    bytes_ += bytes;
  }
  return std::make_unique<Ticket>(*this, bytes);
}

void Admission::leave(uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  --requests_;
  bytes_ -= bytes;
}

}  // namespace barycast::server
