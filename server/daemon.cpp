#include "daemon.h"

#include <fmt/format.h>
#include <grpc/support/log.h>
#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>

#include <future>
#include <mutex>

#include "health.grpc.pb.h"
#include "log.h"
#include "machine.h"
#include "metrics.h"
#include "service.h"

namespace barycast::server {
namespace {

constexpr const char* kServiceName = "barycast.v1.BarycastService";

// Many more than may work at once; beyond it a connection's calls wait at the client.
constexpr int kStreamsPerConnection = 1024;

bool is_unix(const std::string& address) {
  return address.starts_with("unix:");
}

// gRPC's own complaints become events of our log, in its format.
void route_grpc_log() {
  gpr_set_log_function([](gpr_log_func_args* args) {
    log_event(args->severity == GPR_LOG_SEVERITY_ERROR ? "error" : "debug", std::string("grpc: ") + args->message);
  });
}

class GrpcDaemon final : public Daemon {
 public:
  explicit GrpcDaemon(const DaemonSettings& settings)
      : state_{.limits = settings.limits,
               .arena = ComputeArena(settings.threads > 0 ? settings.threads : usable_threads()),
               .cages = CageCache(settings.cache_bytes_max),
               .kernels = KernelCache(settings.smoothing_cache_bytes_max),
               .admission = Admission(settings.admission),
               .counters = {}},
        service_(make_service(state_)) {}

  ~GrpcDaemon() override { stop(std::chrono::milliseconds(0)); }

  Status listen(const std::string& listen) {
    static std::once_flag once;
    std::call_once(once, [] {
      route_grpc_log();
      grpc::EnableDefaultHealthCheckService(true);
      grpc::reflection::InitProtoReflectionServerBuilderPlugin();
    });
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
    // Both names exist from now on, so that Watch has something to tell.
    server_->GetHealthCheckService()->SetServingStatus(kServiceName, false);
    server_->GetHealthCheckService()->SetServingStatus(false);
    return Done{};
  }

  Status expose(const std::string& metrics_listen) {
    if (metrics_listen.empty()) return Done{};
    Result<std::unique_ptr<Metrics>> metrics = Metrics::listen(metrics_listen, state_);
    if (!metrics) return metrics.error();
    metrics_ = std::move(*metrics);
    metrics_address_ = metrics_->address();
    return Done{};
  }

  // Ready once `self_test` has passed, on the threads that will compute.
  Status get_ready(const std::function<Status()>& self_test) {
    std::promise<Status> promise;
    state_.arena.post([&] { promise.set_value(self_test()); });
    if (Status tested = promise.get_future().get(); !tested) return tested;
    state_.ready = true;
    server_->GetHealthCheckService()->SetServingStatus(true);
    return Done{};
  }

  const std::string& address() const override { return address_; }
  const std::string& metrics_address() const override { return metrics_address_; }
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
  std::unique_ptr<Metrics> metrics_;
  std::string address_, metrics_address_;
};

}  // namespace

Result<std::unique_ptr<Daemon>> Daemon::start(const DaemonSettings& settings) {
  auto daemon = std::make_unique<GrpcDaemon>(settings);
  if (Status listening = daemon->listen(settings.listen); !listening) return listening.error();
  if (Status exposed = daemon->expose(settings.metrics_listen); !exposed) return exposed.error();
  if (Status ready = daemon->get_ready(settings.self_test); !ready) return ready.error();
  return Result<std::unique_ptr<Daemon>>(std::move(daemon));
}

Health probe(const std::string& address, std::chrono::milliseconds timeout) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);  // it is for the web, not for a server beside us
  const auto channel = grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
  const auto stub = grpc::health::v1::Health::NewStub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + timeout);
  grpc::health::v1::HealthCheckRequest request;
  request.set_service(kServiceName);
  grpc::health::v1::HealthCheckResponse response;
  const grpc::Status status = stub->Check(&context, request, &response);
  if (status.error_code() == grpc::StatusCode::UNAVAILABLE ||
      status.error_code() == grpc::StatusCode::DEADLINE_EXCEEDED) {
    return Health::kNoAnswer;
  }
  const bool serves = status.ok() && response.status() == grpc::health::v1::HealthCheckResponse::SERVING;
  return serves ? Health::kServing : Health::kNotServing;
}

}  // namespace barycast::server
