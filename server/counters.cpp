#include "counters.h"

namespace barycast::server {

const char* method_name(Method method) {
  constexpr std::array<const char*, kMethodCount> kNames = {"GetCapabilities", "FindMissingCages", "UploadCage",
                                                            "EstimateCost", "ComputeCoordinates"};
  return kNames[static_cast<size_t>(method)];
}

const char* code_name(size_t code) {
  constexpr std::array<const char*, kCodeCount> kNames = {
      "OK",        "CANCELLED",      "UNKNOWN",           "INVALID_ARGUMENT",   "DEADLINE_EXCEEDED",
      "NOT_FOUND", "ALREADY_EXISTS", "PERMISSION_DENIED", "RESOURCE_EXHAUSTED", "FAILED_PRECONDITION",
      "ABORTED",   "OUT_OF_RANGE",   "UNIMPLEMENTED",     "INTERNAL",           "UNAVAILABLE",
      "DATA_LOSS", "UNAUTHENTICATED"};
  return code < kCodeCount ? kNames[code] : "UNKNOWN";
}

}  // namespace barycast::server
