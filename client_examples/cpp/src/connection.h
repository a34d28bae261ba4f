#pragma once

// A channel to one server, and single attempts of the unary calls and of the upload. Thread-safe.
// Includes gRPC: keep it out of the other files (it costs 10 to 45 s of compilation each).

#include <grpcpp/grpcpp.h>

#include <atomic>
#include <functional>
#include <mutex>
#include <optional>
#include <stop_token>

#include "barycast/client/client.h"
#include "barycast/v1/barycast.grpc.pb.h"
#include "failure.h"
#include "retry.h"

namespace barycast::client {

// How a request names its cage; each step is the answer to a server that does not hold it.
enum class CageBy { kDigest, kUploadThenDigest, kInline };

// The context of one attempt: deadline, cancellation, metadata.
class CallContext {
 public:
  // cage: its digest travels as plain metadata, so that a balancer can send a cage's requests to one replica.
  CallContext(const Retry& retry, const Cage* cage);

  grpc::ClientContext& get() { return context_; }
  // The failure of a status that is not OK; says so where the caller stopped.
  Failure failure(const grpc::Status& status) const;

 private:
  grpc::ClientContext context_;
  std::stop_token stop_;
  std::stop_callback<std::function<void()>> cancel_;
};

class Connection {
 public:
  explicit Connection(const ClientSettings& settings);

  v1::BarycastService::Stub& stub() { return *stub_; }
  Retry new_retry(const std::stop_token& stop) const {
    return Retry(settings_.retry_time_max, settings_.time_max, stop);
  }

  // See Client.
  bool answered() const { return answered_; }

  // Asked once, and again after an attempt failed: another server may answer then.
  Outcome capabilities(const Retry& retry, Capabilities& result);
  Outcome upload(const Cage& cage, const UploadOptions& options, const Retry& retry, Uploaded& result);
  Outcome estimate(const v1::EstimateCostRequest& request, const Cage& cage, const Retry& retry, Cost& result);

  // Attempts until one succeeds or its failure is final.
  Outcome retried(Retry& retry, const std::function<Outcome()>& attempt);
  // The same for requests with a cage: an upload, and then the cage itself, where the server does not hold it.
  Outcome retried(Retry& retry, const Cage& cage, const std::function<Outcome(CageBy)>& attempt);

 private:
  // Whether to try again; forgets what the last server said about itself.
  bool again(Retry& retry, const Failure& failure);

  const ClientSettings settings_;
  const Status valid_;                               // what is wrong with the address
  std::unique_ptr<v1::BarycastService::Stub> stub_;  // none, where something is
  std::atomic<bool> answered_{false};
  std::mutex mutex_;
  std::optional<Capabilities> capabilities_;
};

}  // namespace barycast::client
