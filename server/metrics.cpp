#include "metrics.h"

#include <fmt/format.h>
#include <prometheus/client_metric.h>
#include <prometheus/collectable.h>
#include <prometheus/exposer.h>
#include <prometheus/metric_family.h>
#include <prometheus/metric_type.h>

#include <exception>
#include <limits>

#include "bind/options.h"

namespace barycast::server {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;
using Labels = std::vector<ClientMetric::Label>;

// Scrapes are rare and short; one thread answers them.
constexpr size_t kThreads = 1;

class Page {
 public:
  void gauge(const char* name, const char* help, double value, Labels labels = {}) {
    ClientMetric& metric = add(name, help, MetricType::Gauge, std::move(labels));
    metric.gauge.value = value;
  }
  void counter(const char* name, const char* help, double value, Labels labels = {}) {
    ClientMetric& metric = add(name, help, MetricType::Counter, std::move(labels));
    metric.counter.value = value;
  }
  void histogram(const char* name, const char* help, const DurationHistogram& from, Labels labels = {}) {
    ClientMetric::Histogram& to = add(name, help, MetricType::Histogram, std::move(labels)).histogram;
    uint64_t count = 0;
    for (size_t i = 0; i < DurationHistogram::kBounds.size(); ++i) {
      count += from.in_bucket(i);
      to.bucket.push_back({count, DurationHistogram::kBounds[i]});
    }
    count += from.in_bucket(DurationHistogram::kBounds.size());
    to.bucket.push_back({count, std::numeric_limits<double>::infinity()});
    to.sample_count = count;
    to.sample_sum = from.sum_s();
  }
  std::vector<MetricFamily> take() { return std::move(families_); }

 private:
  // Metrics of one family are added one after another.
  ClientMetric& add(const char* name, const char* help, MetricType type, Labels labels) {
    if (families_.empty() || families_.back().name != name) families_.push_back({name, help, type, {}});
    families_.back().metric.push_back({});
    families_.back().metric.back().label = std::move(labels);
    return families_.back().metric.back();
  }
  std::vector<MetricFamily> families_;
};

double read(const std::atomic<uint64_t>& value) {
  return static_cast<double>(value.load(std::memory_order_relaxed));
}

void add_requests(const Counters& counters, Page& page) {
  for (size_t method = 0; method < kMethodCount; ++method) {
    for (size_t code = 0; code < kCodeCount; ++code) {
      const double ended = read(counters.calls[method][code]);
      // A series that starts at 0 has a rate from its first increase on; the others appear when they happen.
      if (code == 0 || ended > 0)
        page.counter("barycastd_requests_total", "Calls that ended, by method and status code.", ended,
                     {{"method", method_name(static_cast<Method>(method))}, {"code", code_name(code)}});
    }
  }
  for (size_t method = 0; method < kMethodCount; ++method)
    page.histogram("barycastd_request_duration_seconds", "From a call's beginning to its end.",
                   counters.durations[method], {{"method", method_name(static_cast<Method>(method))}});
  for (size_t stage = 0; stage < kStageNames.size(); ++stage)
    page.counter("barycastd_stage_seconds_total", "Wall time of computations, by stage.",
                 1e-9 * read(counters.stage_ns[stage]), {{"stage", kStageNames[stage]}});
  page.counter("barycastd_samples_total", "Walks or rays started.", read(counters.samples));
  page.counter("barycastd_rows_total", "Rows made.", read(counters.rows));
  page.counter("barycastd_entries_total", "Coordinates in these rows.", read(counters.entries));
  page.gauge("barycastd_requests_active", "Calls that have begun and not ended.",
             static_cast<double>(counters.calls_active.load(std::memory_order_relaxed)));
}

void add_kernels(const KernelCache::Stats& stats, Page& page) {
  const char* const name = "barycastd_smoothing_cache_lookups_total";
  const char* const help = "Lookups of factors of denoising: held (hit) or not (miss).";
  page.counter(name, help, static_cast<double>(stats.hits), {{"result", "hit"}});
  page.counter(name, help, static_cast<double>(stats.misses), {{"result", "miss"}});
  page.counter("barycastd_smoothing_cache_evictions_total", "Factors that made room for others.",
               static_cast<double>(stats.evictions));
  page.gauge("barycastd_smoothing_cache_bytes", "Memory of the factors held.", static_cast<double>(stats.bytes));
  page.gauge("barycastd_smoothing_cache_entries", "Factors held.", static_cast<double>(stats.entries));
}

void add_resources(const ServiceState& state, Page& page) {
  const Admission::Usage usage = state.admission.usage();
  page.gauge("barycastd_admitted_requests", "Requests admitted to work now.", usage.requests);
  page.gauge("barycastd_admitted_bytes", "Working memory promised to them.", static_cast<double>(usage.bytes));
  page.counter("barycastd_overload_refusals_total", "Requests refused for being busy.",
               static_cast<double>(usage.refused));
  page.histogram("barycastd_queue_wait_seconds", "From a task's posting to its start on the compute arena.",
                 state.arena.waits());
  page.gauge("barycastd_arena_threads", "Compute threads.", state.arena.threads());
  const CageCache::Stats stats = state.cages.stats();
  const char* const name = "barycastd_cage_cache_lookups_total";
  const char* const help = "Lookups of cages: held (hit), built by another request (join), neither (miss).";
  page.counter(name, help, static_cast<double>(stats.hits), {{"result", "hit"}});
  page.counter(name, help, static_cast<double>(stats.joins), {{"result", "join"}});
  page.counter(name, help, static_cast<double>(stats.misses), {{"result", "miss"}});
  page.counter("barycastd_cage_cache_evictions_total", "Cages that made room for others.",
               static_cast<double>(stats.evictions));
  page.gauge("barycastd_cage_cache_bytes", "Memory of the cages held.", static_cast<double>(state.cages.bytes()));
  page.gauge("barycastd_cage_cache_entries", "Cages held.", static_cast<double>(state.cages.entry_count()));
  add_kernels(state.kernels.stats(), page);
}

class Collector final : public prometheus::Collectable {
 public:
  explicit Collector(const ServiceState& state) : state_(state) {}
  std::vector<MetricFamily> Collect() const override {
    Page page;
    page.gauge("barycastd_build_info", "Always 1; its labels say what runs.", 1,
               {{"version", BARYCAST_VERSION}, {"numerics_version", std::to_string(kNumericsVersion)}});
    page.gauge("barycastd_serving", "1 while the server is ready and does not drain.",
               state_.ready && !state_.draining ? 1 : 0);
    add_requests(state_.counters, page);
    add_resources(state_, page);
    return page.take();
  }

 private:
  const ServiceState& state_;
};

class Exposed final : public Metrics {
 public:
  Exposed(const std::string& address, const ServiceState& state)
      : collector_(std::make_shared<Collector>(state)), exposer_(address, kThreads) {
    exposer_.RegisterCollectable(collector_);
    address_ = address.substr(0, address.rfind(':') + 1) + std::to_string(exposer_.GetListeningPorts().at(0));
  }
  const std::string& address() const override { return address_; }

 private:
  std::shared_ptr<Collector> collector_;
  prometheus::Exposer exposer_;
  std::string address_;
};

}  // namespace

Result<std::unique_ptr<Metrics>> Metrics::listen(const std::string& address, const ServiceState& state) {
  try {
    return Result<std::unique_ptr<Metrics>>(std::make_unique<Exposed>(address, state));
  } catch (const std::exception&) {
    return invalid_argument("metrics-listen",
                            fmt::format("cannot bind {}; is the address HOST:PORT, right, and free?", address));
  }
}

}  // namespace barycast::server
