#include "daemon.h"

#include <fmt/format.h>
#include <grpcpp/ext/health_check_service_server_builder_option.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>

#include <future>

#include "health.grpc.pb.h"
#include "machine.h"
#include "self_test.h"
#include "service.h"

namespace barycast::server {
namespace {

constexpr const char* kServiceName = "barycast.v1.BarycastService";

// Many more than may work at once; beyond it a connection's calls wait at the client.
constexpr int kStreamsPerConnection = 1024;

bool is_unix(const std::string& address) {
  return address.starts_with("unix:");
}

class GrpcDaemon final : public Daemon {
 public:
  explicit GrpcDaemon(const DaemonSettings& settings)
      : state_{.limits = settings.limits,
               .arena = ComputeArena(settings.threads > 0 ? settings.threads : usable_threads()),
               .cages = CageCache(settings.cache_bytes_max),
               .admission = Admission(settings.admission),
               .counters = {}},
        service_(make_service(state_)) {}

  ~GrpcDaemon() override { stop(std::chrono::milliseconds(0)); }

  Status serve(const std::string& listen) {
    grpc::EnableDefaultHealthCheckService(true);
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort(listen, grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(service_.get());
    builder.SetMaxReceiveMessageSize(static_cast<int>(state_.limits.message_bytes_max));
    // Two servers on one port would share its calls at random.
    builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
    // Bytes on their way in and out of all connections, beside what admission counts.
    builder.SetResourceQuota(grpc::ResourceQuota("barycastd").Resize(state_.limits.transport_bytes_max));
    builder.AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, kStreamsPerConnection);
    // A peer that vanished without a word must not hold a place for ever.
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 60'000);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 20'000);
    server_ = builder.BuildAndStart();
    if (!server_ || port == 0) {
      return invalid_argument("listen", fmt::format("cannot bind {}; is the address right, and free?", listen));
    }
    address_ = is_unix(listen) ? listen : listen.substr(0, listen.rfind(':') + 1) + std::to_string(port);
    server_->GetHealthCheckService()->SetServingStatus(kServiceName, true);
    return Done{};
  }

  Status test() {
    std::promise<Status> promise;
    state_.arena.post([&promise] { promise.set_value(self_test()); });
    return promise.get_future().get();
  }

  const std::string& address() const override { return address_; }
  int threads() const override { return state_.arena.threads(); }
  const Counters& counters() const override { return state_.counters; }
  bool busy() const override { return state_.counters.calls_active > 0; }

  void begin_drain() override {
    server_->GetHealthCheckService()->SetServingStatus(false);
    state_.draining = true;
  }

  void stop(std::chrono::milliseconds grace) override {
    if (!server_) return;
    server_->Shutdown(std::chrono::system_clock::now() + grace);
    server_->Wait();
    server_.reset();
  }

 private:
  ServiceState state_;
  std::unique_ptr<grpc::Service> service_;
  std::unique_ptr<grpc::Server> server_;
  std::string address_;
};

}  // namespace

Result<std::unique_ptr<Daemon>> Daemon::start(const DaemonSettings& settings) {
  auto daemon = std::make_unique<GrpcDaemon>(settings);
  if (Status tested = daemon->test(); !tested) return tested.error();
  if (Status serving = daemon->serve(settings.listen); !serving) return serving.error();
  return Result<std::unique_ptr<Daemon>>(std::move(daemon));
}

bool probe(const std::string& address, std::chrono::milliseconds timeout) {
  const auto channel = grpc::CreateChannel(address, grpc::InsecureChannelCredentials());
  const auto stub = grpc::health::v1::Health::NewStub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + timeout);
  grpc::health::v1::HealthCheckRequest request;
  request.set_service(kServiceName);
  grpc::health::v1::HealthCheckResponse response;
  return stub->Check(&context, request, &response).ok() &&
         response.status() == grpc::health::v1::HealthCheckResponse::SERVING;
}

}  // namespace barycast::server
