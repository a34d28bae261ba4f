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
    auto& [requests, promised, refused] = usage_;
    if (requests >= bounds_.requests_max) {
      ++refused;
      return busy(fmt::format("busy with {} requests; try again later", requests));
    }
    // A request alone is always admitted: request_bytes_max has judged it by itself.
    if (requests > 0 && bytes > bounds_.bytes_max - std::min(promised, bounds_.bytes_max)) {
      ++refused;
      return busy(fmt::format(
          "busy: {} bytes of working memory are promised and this request needs {}; try again later", promised, bytes));
    }
    ++requests;
    promised += bytes;
  }
  return std::make_unique<Ticket>(*this, bytes);
}

void Admission::leave(uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  --usage_.requests;
  usage_.bytes -= bytes;
}

Admission::Usage Admission::usage() const {
  const std::lock_guard lock(mutex_);
  return usage_;
}

}  // namespace barycast::server
