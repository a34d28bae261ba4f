#pragma once

// Sizes beyond which a request is refused before work starts; GetCapabilities tells clients. Plain data,
// set once at start.

#include <chrono>
#include <cstdint>

namespace barycast::server {

struct Limits {
  uint64_t cage_bytes_max = 64ull << 20;               // canonical bytes of one cage
  uint64_t points_max = 100'000'000;                   // query points of one request
  uint64_t faces_max = 200'000'000;                    // faces of the query set of one request
  uint32_t samples_max = 100'000;                      // samples per query point
  uint32_t block_rows_max = 65'536;                    // rows per block of the answer
  uint64_t message_bytes_max = 64ull << 20;            // one message from the client
  uint32_t digests_max = 1'000;                        // of one FindMissingCages request
  uint64_t request_bytes_max = 4ull << 30;             // estimated working memory of one request
  uint64_t transport_bytes_max = 1ull << 30;           // messages on their way in and out of all calls
  std::chrono::milliseconds receive_idle_max{60'000};  // between two messages of a client that is still sending
};

}  // namespace barycast::server
