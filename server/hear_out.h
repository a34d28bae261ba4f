#pragma once

// A refusal to a client behind a proxy, while the client is still sending. A proxy that gets a status before the client
// has sent all may reset the stream and lose the status (HAProxy 2.6 does); so what still comes is read and dropped
// first, for a bounded time. Without a proxy a refusal is sent at once.
//
//   refuse:      if (!hear_out.wanted()) return finish(status); give back everything; hear_out.begin(status); hear();
//   OnReadDone:  if (hear_out.begun()) return ok ? hear() : finish(hear_out.status());
//   hear:        drop the message; hear_out.read(timeout, cancelled, start_read, finish);

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <optional>
#include <utility>

#include "read_timeout.h"

namespace barycast::server {

class HearOut {
 public:
  // A megabyte and more on the slowest network, several hundred of them on a fast one. Who still sends then may not
  // learn why it was refused.
  static constexpr std::chrono::milliseconds kMax{1000};

  explicit HearOut(const grpc::CallbackServerContext& context)
      : wanted_(context.client_metadata().count("x-forwarded-for") > 0) {}

  bool wanted() const { return wanted_; }
  void begin(grpc::Status status) {
    status_ = std::move(status);
    end_ = std::chrono::steady_clock::now() + kMax;
  }
  bool begun() const { return status_.has_value(); }
  const grpc::Status& status() const { return *status_; }

  // Starts the next read, or finishes with the status where there is no time left; whichever of the read and the time
  // ends first has the call.
  template <class StartRead, class Finish>
  void read(ReadTimeout& timeout, bool cancelled, const StartRead& start_read, const Finish& finish) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end_ - std::chrono::steady_clock::now());
    if (cancelled || left.count() <= 0) return finish(*status_);
    timeout.watch(left, start_read, [this, finish] { finish(*status_); });
  }

 private:
  const bool wanted_;
  std::optional<grpc::Status> status_;
  std::chrono::steady_clock::time_point end_;
};

}  // namespace barycast::server
