#pragma once

// One ComputeCoordinates request from its header to its summary, without its transport: what arrives is
// checked and collected, then `step` is pulled until the end. Each call does a bounded piece of work and
// never blocks; all calls are made on the compute arena, one at a time.
//
//   receive(header) receive(points)* receive(faces)* end_of_input() step()* close()
//
// After a refusal nothing else may be called but close(). Memory: what the client sent, the binding, and
// the admission of both, all given back by close().

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <variant>

#include "barycast/v1/barycast.pb.h"
#include "query_assembler.h"
#include "refusal.h"
#include "request_cost.h"
#include "service_state.h"

namespace barycast::server {

class ComputeJob {
 public:
  using Response = v1::ComputeCoordinatesResponse;

  // `metadata_digest`: the x-cage-digest that came with the call, or empty.
  ComputeJob(ServiceState& state, std::string metadata_digest);

  // `then` is called exactly once, with what is wrong or nothing; later and on another thread where the
  // cage is being built by another request.
  void receive(const v1::ComputeCoordinatesRequest& message, std::function<void(std::optional<Refusal>)> then);
  // Everything is there: builds what the computation asks of the cage. `then` as above.
  void prepare(std::function<void(std::optional<Refusal>)> then);
  // After that: makes the binding. The answer's header, or what is wrong.
  std::variant<Response, Refusal> begin(const std::atomic<bool>& cancel);

  struct Step {
    std::optional<Response> message;
    bool is_last = false;  // the message is the summary
    std::optional<Refusal> refusal;
  };
  // `report`: also say how far it is, a few times per second.
  Step step(const std::atomic<bool>& cancel, bool report);

  void close();
  // What is known by now; counts and times are complete after close().
  const RequestFacts& facts() const { return facts_; }

 private:
  using Then = std::function<void(std::optional<Refusal>)>;
  void start(const v1::ComputeHeader& header, Then then);
  // Understands the header. `cage`: the one it brings, if it does. `digest`: of the cage, brought or named.
  std::optional<Refusal> open(const v1::ComputeHeader& header, std::optional<CageStorage>& cage, CageDigest& digest);
  std::optional<Refusal> collect(const v1::ComputeCoordinatesRequest& message);
  std::optional<Refusal> use_index(Result<CageCache::Index> index, bool cache_hit);
  std::optional<Refusal> admit(const BindingSize& cage_size);
  std::optional<Response> progress_message();

  using Clock = std::chrono::steady_clock;
  ServiceState& state_;
  const std::string metadata_digest_;
  std::optional<ComputePlan> plan_;
  RequestFacts facts_;
  uint32_t block_rows_ = 0;
  Clock::time_point cage_start_;
  double cage_s_ = 0.0;
  std::unique_ptr<Admission::Ticket> ticket_;
  CageCache::Index index_;
  std::optional<QueryAssembler> assembler_;
  std::unique_ptr<Binding> binding_;
  Clock::time_point reported_;
  BindingSummary summary_;  // as of the end
};

}  // namespace barycast::server
