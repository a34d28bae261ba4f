#include "service.h"

#include "barycast/v1/barycast.grpc.pb.h"
#include "call_log.h"
#include "compute_call.h"
#include "decode.h"
#include "encode.h"
#include "request_cost.h"
#include "status.h"
#include "upload_call.h"

namespace barycast::server {
namespace {

// A unary call with its line in the log. Deletes itself when gRPC is done with it.
class UnaryCall : public grpc::ServerUnaryReactor {
 public:
  UnaryCall(ServiceState& state, Method method, grpc::CallbackServerContext& context) : log_(state, method, context) {}
  // The last thing done with `this`.
  void send(const grpc::Status& status) {
    log_.set_outcome(status, facts);
    Finish(status);
  }
  void OnCancel() override { log_.mark_cancelled(); }
  void OnDone() override { delete this; }

  RequestFacts facts;

 private:
  CallLog log_;
};

class Service final : public v1::BarycastService::CallbackService {
 public:
  explicit Service(ServiceState& state) : state_(state) {}

  grpc::ServerUnaryReactor* GetCapabilities(grpc::CallbackServerContext* context, const v1::GetCapabilitiesRequest*,
                                            v1::GetCapabilitiesResponse* response) override {
    *response = encode_capabilities(state_.limits, BARYCAST_VERSION);
    return finish(Method::kGetCapabilities, context, grpc::Status::OK);
  }

  grpc::ServerUnaryReactor* FindMissingCages(grpc::CallbackServerContext* context,
                                             const v1::FindMissingCagesRequest* request,
                                             v1::FindMissingCagesResponse* response) override {
    const Result<std::vector<CageDigest>> digests = decode_digests(*request, state_.limits);
    if (!digests) return finish(Method::kFindMissingCages, context, to_status({digests.error(), {}, {}}));
    for (const CageDigest& digest : *digests) {
      if (!state_.cages.contains(digest)) *response->add_missing() = encode_digest(digest);
    }
    return finish(Method::kFindMissingCages, context, grpc::Status::OK);
  }

  grpc::ServerUnaryReactor* EstimateCost(grpc::CallbackServerContext* context, const v1::EstimateCostRequest* request,
                                         v1::EstimateCostResponse* response) override {
    auto* call = new UnaryCall(state_, Method::kEstimateCost, *context);
    if (const std::optional<Refusal> refusal = closed(state_)) {
      call->send(to_status(*refusal));
      return call;
    }
    // A cage that comes along may be large: it is read on the arena.
    state_.arena.post([this, call, request, response, digest = cage_digest_metadata(*context)] {
      const auto then = [call, response](const std::variant<RequestCost, Refusal>& answer) {
        if (const Refusal* refusal = std::get_if<Refusal>(&answer)) return call->send(to_status(*refusal));
        encode_cost(std::get<RequestCost>(answer), *response);
        call->send(grpc::Status::OK);
      };
      const std::optional<Refusal> failure = guarded([&]() -> std::optional<Refusal> {
        estimate_cost(state_, decode_header(*request, state_.limits), digest, call->facts, then);
        return std::nullopt;
      });
      if (failure) call->send(to_status(*failure));
    });
    return call;
  }

  grpc::ServerReadReactor<v1::UploadCageRequest>* UploadCage(grpc::CallbackServerContext* context,
                                                             v1::UploadCageResponse* response) override {
    return new_upload_call(state_, *context, *response);
  }

  grpc::ServerBidiReactor<v1::ComputeCoordinatesRequest, v1::ComputeCoordinatesResponse>* ComputeCoordinates(
      grpc::CallbackServerContext* context) override {
    return new_compute_call(state_, *context);
  }

 private:
  grpc::ServerUnaryReactor* finish(Method method, grpc::CallbackServerContext* context, const grpc::Status& status) {
    auto* call = new UnaryCall(state_, method, *context);
    call->send(status);
    return call;
  }

  ServiceState& state_;
};

}  // namespace

std::unique_ptr<grpc::Service> make_service(ServiceState& state) {
  return std::make_unique<Service>(state);
}

}  // namespace barycast::server
