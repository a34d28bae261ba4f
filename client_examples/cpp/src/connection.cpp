#include "connection.h"

#include <algorithm>

#include "messages.h"
#include "rpc_status.h"

namespace barycast::client {
namespace {

constexpr uint64_t kUploadPieceBytes = 1 << 20;

std::shared_ptr<grpc::Channel> connect(const std::string& address) {
  grpc::ChannelArguments arguments;
  // A farm's proxy is for the web, not for a service beside us.
  arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
  // Blocks of rows are bounded by the server, and ours are cut to its limit.
  arguments.SetMaxReceiveMessageSize(-1);
  arguments.SetMaxSendMessageSize(-1);
  // A Client's connection is its own.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  // Servers tolerate a ping every five minutes unless told otherwise.
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 360'000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 20'000);
  // Our own waits space the attempts; the channel must not be slower than they are.
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 1000);
  return grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
}

}  // namespace

CallContext::CallContext(const Retry& retry, const Cage* cage)
    : stop_(retry.stop()), cancel_(retry.stop(), [this] { context_.TryCancel(); }) {
  if (cage != nullptr) context_.AddMetadata("x-cage-digest", cage->digest().hexadecimal());
  if (retry.deadline()) {
    context_.set_deadline(std::chrono::system_clock::now() + (*retry.deadline() - Retry::Clock::now()));
  }
}

Failure CallContext::failure(const grpc::Status& status) const {
  if (stop_.stop_requested()) return {.error = {.code = Code::kCancelled, .message = "cancelled by the caller"}};
  return to_failure(status);
}

Connection::Connection(const ClientSettings& settings) : settings_(settings), valid_(check_address(settings.address)) {
  if (valid_) stub_ = v1::BarycastService::NewStub(connect(settings.address));
}

Outcome Connection::capabilities(const Retry& retry, Capabilities& result) {
  {
    const std::lock_guard lock(mutex_);
    if (capabilities_) {
      result = *capabilities_;
      return std::nullopt;
    }
  }
  CallContext context(retry, nullptr);
  v1::GetCapabilitiesResponse response;
  const grpc::Status status = stub_->GetCapabilities(&context.get(), {}, &response);
  if (!status.ok()) return context.failure(status);
  result = from_message(response);
  answered_ = true;
  const std::lock_guard lock(mutex_);
  capabilities_ = result;
  return std::nullopt;
}

Outcome Connection::upload(const Cage& cage, const UploadOptions& options, const Retry& retry, Uploaded& result) {
  Capabilities capabilities;
  if (Outcome failure = this->capabilities(retry, capabilities)) return failure;
  // Half for the piece: the digest and the field's tags need little.
  const uint64_t piece_max = std::clamp<uint64_t>(capabilities.message_bytes_max / 2, 1, kUploadPieceBytes);
  const std::string bytes = to_message(cage).SerializeAsString();
  CallContext context(retry, &cage);
  v1::UploadCageResponse response;
  const auto writer = stub_->UploadCage(&context.get(), &response);
  for (uint64_t begin = 0; begin < bytes.size(); begin += piece_max) {
    v1::UploadCageRequest request;
    if (begin == 0) *request.mutable_expected_digest() = to_message(cage.digest());
    request.set_fill_tables(options.fill_tables && begin == 0);
    request.set_piece(bytes.substr(begin, piece_max));
    if (!writer->Write(request)) break;  // refused: the status says why
  }
  writer->WritesDone();
  const grpc::Status status = writer->Finish();
  if (!status.ok()) return context.failure(status);
  answered_ = true;
  result = from_message(response);
  return std::nullopt;
}

Outcome Connection::estimate(const v1::EstimateCostRequest& request, const Cage& cage, const Retry& retry,
                             Cost& result) {
  CallContext context(retry, &cage);
  v1::EstimateCostResponse response;
  const grpc::Status status = stub_->EstimateCost(&context.get(), request, &response);
  if (!status.ok()) return context.failure(status);
  answered_ = true;
  result = {response.memory_bytes(), response.samples(), response.output_bytes()};
  return std::nullopt;
}

bool Connection::again(Retry& retry, const Failure& failure) {
  if (failure.error.code == Code::kUnavailable) {
    answered_ = false;
    const std::lock_guard lock(mutex_);
    capabilities_.reset();
  }
  return retry.wait(failure);
}

Outcome Connection::retried(Retry& retry, const std::function<Outcome()>& attempt) {
  if (!valid_) return Failure{.error = valid_.error()};
  for (;;) {
    Outcome failure = attempt();
    if (!failure || !again(retry, *failure)) return failure;
  }
}

Outcome Connection::retried(Retry& retry, const Cage& cage, const std::function<Outcome(CageBy)>& attempt) {
  if (!valid_) return Failure{.error = valid_.error()};
  CageBy by = CageBy::kDigest;
  for (;;) {
    Outcome failure;
    Uploaded uploaded;
    if (by == CageBy::kUploadThenDigest) failure = upload(cage, {}, retry, uploaded);
    if (!failure) failure = attempt(by);
    if (!failure) return std::nullopt;
    if (failure->cage_missing && by != CageBy::kInline) {
      by = by == CageBy::kDigest ? CageBy::kUploadThenDigest : CageBy::kInline;
    } else if (!again(retry, *failure)) {
      return failure;
    }
  }
}

}  // namespace barycast::client
