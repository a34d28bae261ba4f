#include "service.h"

#include "barycast/v1/barycast.grpc.pb.h"
#include "compute_call.h"
#include "decode.h"
#include "encode.h"
#include "status.h"
#include "upload_call.h"

namespace barycast::server {
namespace {

class Service final : public v1::BarycastService::CallbackService {
 public:
  explicit Service(ServiceState& state) : state_(state) {}

  grpc::ServerUnaryReactor* GetCapabilities(grpc::CallbackServerContext* context, const v1::GetCapabilitiesRequest*,
                                            v1::GetCapabilitiesResponse* response) override {
    *response = encode_capabilities(state_.limits, BARYCAST_VERSION);
    return finish(context, grpc::Status::OK);
  }

  grpc::ServerUnaryReactor* FindMissingCages(grpc::CallbackServerContext* context,
                                             const v1::FindMissingCagesRequest* request,
                                             v1::FindMissingCagesResponse* response) override {
    const Result<std::vector<CageDigest>> digests = decode_digests(*request, state_.limits);
    if (!digests) return finish(context, to_status({digests.error(), {}, {}}));
    for (const CageDigest& digest : *digests) {
      if (!state_.cages.contains(digest)) *response->add_missing() = encode_digest(digest);
    }
    return finish(context, grpc::Status::OK);
  }

  grpc::ServerUnaryReactor* EstimateCost(grpc::CallbackServerContext* context, const v1::EstimateCostRequest*,
                                         v1::EstimateCostResponse*) override {
    const Error error{ErrorCode::kUnimplemented, "", "EstimateCost is not built yet"};
    return finish(context, to_status({error, {}, {}}));
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
  static grpc::ServerUnaryReactor* finish(grpc::CallbackServerContext* context, const grpc::Status& status) {
    grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
    reactor->Finish(status);
    return reactor;
  }

  ServiceState& state_;
};

}  // namespace

std::unique_ptr<grpc::Service> make_service(ServiceState& state) {
  return std::make_unique<Service>(state);
}

}  // namespace barycast::server
