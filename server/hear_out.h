#pragma once

// A refusal to a client behind a proxy, while the client is still sending. A proxy that gets a status before the client
// has sent all may reset the stream and lose the status (HAProxy 2.6 does); so what still comes is read and dropped
// first, for a bounded time. Without a proxy a refusal is sent at once.
//
//   refuse:      if (!hear_out.wanted()) return finish(status); give back everything; hear_out.begin(status); next read
//   OnReadDone:  if (hear_out.begun()) ok and left() > 0 ? next read : finish(hear_out.status())

#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

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
  std::chrono::milliseconds left() const {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end_ - std::chrono::steady_clock::now());
    return std::max(left, std::chrono::milliseconds(0));
  }

 private:
  const bool wanted_;
  std::optional<grpc::Status> status_;
  std::chrono::steady_clock::time_point end_;
};

}  // namespace barycast::server
