#pragma once

// A small blocking client for the tests; gRPC stays in client.cpp. Every call has a deadline, so no test
// can wait for ever.

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "barycast/v1/barycast.pb.h"
#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"

namespace barycast::server::testing {

// gRPC's numbers.
enum Code {
  kOk = 0,
  kCancelled = 1,
  kInvalidArgument = 3,
  kDeadlineExceeded = 4,
  kResourceExhausted = 8,
  kFailedPrecondition = 9,
  kUnimplemented = 12,
  kUnavailable = 14,
};

struct Outcome {
  int code = -1;
  std::string message;
  google::rpc::Status details;

  // The path in BadRequest, or empty.
  std::string field() const;
  // The digest in a PreconditionFailure of type MISSING, or empty.
  std::string missing() const;
  bool has_retry() const;
};

struct Answer : Outcome {
  std::optional<v1::ResponseHeader> header;
  std::vector<v1::RowBlock> rows;
  std::optional<v1::Summary> summary;
  int progress_count = 0;
};

struct CallSettings {
  std::chrono::milliseconds deadline{60'000};
  std::vector<std::pair<std::string, std::string>> metadata = {};
};

class Stream {
 public:
  virtual ~Stream() = default;
  virtual bool write(const v1::ComputeCoordinatesRequest& request) = 0;
  virtual void half_close() = 0;
  virtual bool read(v1::ComputeCoordinatesResponse& response) = 0;
  virtual void cancel() = 0;
  // Reads what is left.
  virtual Outcome finish() = 0;
};

class Client {
 public:
  explicit Client(const std::string& address);
  ~Client();

  Answer compute(const std::vector<v1::ComputeCoordinatesRequest>& requests, const CallSettings& settings = {});
  std::unique_ptr<Stream> open(const CallSettings& settings = {});
  Outcome upload(const std::vector<v1::UploadCageRequest>& pieces, v1::UploadCageResponse& response,
                 const CallSettings& settings = {});
  Outcome find_missing(const v1::FindMissingCagesRequest& request, v1::FindMissingCagesResponse& response);
  Outcome capabilities(v1::GetCapabilitiesResponse& response);
  Outcome estimate(const v1::EstimateCostRequest& request, v1::EstimateCostResponse& response,
                   const CallSettings& settings = {});
  // "SERVING", "NOT_SERVING", ..., or the status's number where there is no answer.
  std::string health(const std::string& service);
  // Watches a service's health until it was told `count` states, or for ten seconds: "SERVING,NOT_SERVING".
  // `seen` is called after each.
  std::string watch(const std::string& service, int count, const std::function<void(int)>& seen);

 private:
  struct Stubs;
  std::unique_ptr<Stubs> stubs_;
};

// True once `condition` holds; false after `limit`.
template <class Condition>
bool eventually(const Condition& condition, std::chrono::seconds limit = std::chrono::seconds(20)) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return true;
}

}  // namespace barycast::server::testing
