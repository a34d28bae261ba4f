#include "client.h"

#include <grpcpp/grpcpp.h>

#include "barycast/v1/barycast.grpc.pb.h"
#include "health.grpc.pb.h"

namespace barycast::server::testing {
namespace {

using Api = v1::BarycastService;
using Health = grpc::health::v1::Health;

void prepare(grpc::ClientContext& context, const CallSettings& settings) {
  context.set_deadline(std::chrono::system_clock::now() + settings.deadline);
  for (const auto& [key, value] : settings.metadata) context.AddMetadata(key, value);
}

Outcome outcome(const grpc::Status& status) {
  Outcome result;
  result.code = status.error_code();
  result.message = status.error_message();
  result.details.ParseFromString(status.error_details());
  return result;
}

template <class Detail>
std::optional<Detail> detail(const google::rpc::Status& status) {
  Detail result;
  for (const auto& any : status.details()) {
    if (any.UnpackTo(&result)) return result;
  }
  return std::nullopt;
}

class GrpcStream final : public Stream {
 public:
  GrpcStream(Api::Stub& stub, const CallSettings& settings) {
    prepare(context_, settings);
    stream_ = stub.ComputeCoordinates(&context_);
  }
  bool write(const v1::ComputeCoordinatesRequest& request) override { return stream_->Write(request); }
  void half_close() override { stream_->WritesDone(); }
  bool read(v1::ComputeCoordinatesResponse& response) override { return stream_->Read(&response); }
  void cancel() override { context_.TryCancel(); }
  Outcome finish() override {
    v1::ComputeCoordinatesResponse rest;
    while (stream_->Read(&rest)) {
    }
    return outcome(stream_->Finish());
  }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::ComputeCoordinatesRequest, v1::ComputeCoordinatesResponse>> stream_;
};

}  // namespace

std::string Outcome::field() const {
  const auto bad = detail<google::rpc::BadRequest>(details);
  return bad && bad->field_violations_size() > 0 ? bad->field_violations(0).field() : "";
}

std::string Outcome::missing() const {
  const auto failure = detail<google::rpc::PreconditionFailure>(details);
  return failure && failure->violations_size() > 0 && failure->violations(0).type() == "MISSING"
             ? failure->violations(0).subject()
             : "";
}

bool Outcome::has_retry() const {
  return detail<google::rpc::RetryInfo>(details).has_value();
}

struct Client::Stubs {
  std::unique_ptr<Api::Stub> api;
  std::unique_ptr<Health::Stub> health;
};

Client::Client(const std::string& address) : stubs_(std::make_unique<Stubs>()) {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(-1);
  arguments.SetMaxSendMessageSize(-1);
  // A fixed window of 64 KiB: what the transport takes ahead of a slow reader must not depend on how fast
  // this machine is.
  arguments.SetInt(GRPC_ARG_HTTP2_BDP_PROBE, 0);
  const auto channel = grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
  stubs_->api = Api::NewStub(channel);
  stubs_->health = Health::NewStub(channel);
}

Client::~Client() = default;

std::unique_ptr<Stream> Client::open(const CallSettings& settings) {
  return std::make_unique<GrpcStream>(*stubs_->api, settings);
}

Answer Client::compute(const std::vector<v1::ComputeCoordinatesRequest>& requests, const CallSettings& settings) {
  const std::unique_ptr<Stream> stream = open(settings);
  for (const auto& request : requests) {
    if (!stream->write(request)) break;
  }
  stream->half_close();
  Answer answer;
  for (v1::ComputeCoordinatesResponse response; stream->read(response);) {
    if (response.has_header()) answer.header = response.header();
    if (response.has_progress()) ++answer.progress_count;
    if (response.has_rows()) answer.rows.push_back(response.rows());
    if (response.has_summary()) answer.summary = response.summary();
  }
  static_cast<Outcome&>(answer) = stream->finish();
  return answer;
}

Outcome Client::upload(const std::vector<v1::UploadCageRequest>& pieces, v1::UploadCageResponse& response,
                       const CallSettings& settings) {
  grpc::ClientContext context;
  prepare(context, settings);
  const auto writer = stubs_->api->UploadCage(&context, &response);
  for (const auto& piece : pieces) {
    if (!writer->Write(piece)) break;
  }
  writer->WritesDone();
  return outcome(writer->Finish());
}

Outcome Client::find_missing(const v1::FindMissingCagesRequest& request, v1::FindMissingCagesResponse& response) {
  grpc::ClientContext context;
  prepare(context, {});
  return outcome(stubs_->api->FindMissingCages(&context, request, &response));
}

Outcome Client::capabilities(v1::GetCapabilitiesResponse& response) {
  grpc::ClientContext context;
  prepare(context, {});
  return outcome(stubs_->api->GetCapabilities(&context, {}, &response));
}

Outcome Client::estimate(const v1::EstimateCostRequest& request, v1::EstimateCostResponse& response,
                         const CallSettings& settings) {
  grpc::ClientContext context;
  prepare(context, settings);
  return outcome(stubs_->api->EstimateCost(&context, request, &response));
}

std::string Client::watch(const std::string& service, int count, const std::function<void(int)>& seen) {
  grpc::ClientContext context;
  prepare(context, {.deadline = std::chrono::milliseconds(10'000)});
  grpc::health::v1::HealthCheckRequest request;
  request.set_service(service);
  const auto reader = stubs_->health->Watch(&context, request);
  std::string states;
  grpc::health::v1::HealthCheckResponse response;
  for (int i = 0; i < count && reader->Read(&response); ++i) {
    states += (i > 0 ? "," : "") + grpc::health::v1::HealthCheckResponse::ServingStatus_Name(response.status());
    seen(i);
  }
  context.TryCancel();
  reader->Finish();
  return states;
}

std::string Client::health(const std::string& service) {
  grpc::ClientContext context;
  prepare(context, {.deadline = std::chrono::milliseconds(10'000)});
  grpc::health::v1::HealthCheckRequest request;
  request.set_service(service);
  grpc::health::v1::HealthCheckResponse response;
  const grpc::Status status = stubs_->health->Check(&context, request, &response);
  if (!status.ok()) return std::to_string(status.error_code());
  return grpc::health::v1::HealthCheckResponse::ServingStatus_Name(response.status());
}

}  // namespace barycast::server::testing
