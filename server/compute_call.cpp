#include "compute_call.h"

#include <deque>
#include <mutex>

#include "call_log.h"
#include "compute_job.h"
#include "hear_out.h"
#include "read_timeout.h"

namespace barycast::server {
namespace {

using Request = v1::ComputeCoordinatesRequest;
using Response = v1::ComputeCoordinatesResponse;

// Messages that may be ready while another is being written.
constexpr size_t kMessagesAhead = 1;

// Two phases. Receiving: a chain of read -> task -> read, nothing else in flight; a refusal ends it at
// once, but for a client behind a proxy, whose messages are read and dropped first. It ends with the client's
// half-close, so that nothing is computed for a request that turns out to be wrong. Answering: tasks produce, writes
// consume, and `pump` decides under the mutex what is next. Finish is called when nothing else is in flight, and `this`
// is not touched after it: OnDone deletes.
class ComputeCall final : public grpc::ServerBidiReactor<Request, Response> {
 public:
  ComputeCall(ServiceState& state, grpc::CallbackServerContext& context)
      : state_(state),
        log_(state, Method::kComputeCoordinates, context),
        job_(state, cage_digest_metadata(context)),
        hear_out_(context) {
    if (const std::optional<Refusal> refusal = closed(state)) {
      refuse(*refusal);
    } else {
      read();
    }
  }

  void OnReadDone(bool ok) override {
    if (!timeout_.stop()) return;
    if (hear_out_.begun()) return ok ? hear() : send(hear_out_.status());
    state_.arena.post([this, ok] { ok ? receive() : end_of_input(); });
  }

  void OnWriteDone(bool ok) override {
    std::unique_lock lock(mutex_);
    outgoing_.pop_front();
    writing_ = false;
    if (!ok) log_.mark_cancelled();
    pump(std::move(lock));
  }

  // Whatever is in flight (a read, a task, a write) ends soon, sees the flag, and finishes the call.
  void OnCancel() override { log_.mark_cancelled(); }

  void OnDone() override { delete this; }

 private:
  void read() {
    const auto limit = state_.limits.receive_idle_max;
    // The read that is still under way ends with the call.
    timeout_.watch(
        limit, [this] { StartRead(&request_); }, [this, limit] { conclude(silent_refusal(limit)); });
  }

  // Receiving, on the arena.

  void receive() {
    if (log_.cancelled()) return conclude(cancelled_refusal());
    job_.receive(request_, [this](std::optional<Refusal> refusal) {
      if (refusal) return refuse(*refusal);
      request_ = {};  // Clear() would keep its memory
      read();
    });
  }

  // Before the end of the input, with no read under way.
  void refuse(const Refusal& refusal) {
    if (!hear_out_.wanted()) return conclude(refusal);
    job_.close();
    hear_out_.begin(to_status(refusal));
    hear();
  }

  void hear() {
    request_ = {};
    hear_out_.read(
        timeout_, log_.cancelled(), [this] { StartRead(&request_); },
        [this](const grpc::Status& status) { send(status); });
  }

  void end_of_input() {
    // A broken stream and a half-close both end the input; only the latter is followed by work.
    if (log_.cancelled()) return conclude(cancelled_refusal());
    request_ = {};
    job_.prepare([this](std::optional<Refusal> refusal) {
      if (refusal) return conclude(*refusal);
      state_.arena.post([this] { begin(); });
    });
  }

  void begin() {
    if (log_.cancelled()) return conclude(cancelled_refusal());
    const std::optional<Refusal> refusal = guarded([this]() -> std::optional<Refusal> {
      std::variant<Response, Refusal> header = job_.begin(log_.cancel_flag());
      if (Refusal* refused = std::get_if<Refusal>(&header)) return std::move(*refused);
      outgoing_.push_back(std::move(std::get<Response>(header)));
      return std::nullopt;
    });
    if (refusal) return conclude(*refusal);
    pump(std::unique_lock(mutex_));
  }

  void conclude(const Refusal& refusal) { send(to_status(refusal)); }

  // Answering.

  void step() {
    bool report;
    {
      const std::lock_guard lock(mutex_);
      report = !writing_;
    }
    ComputeJob::Step step;
    const std::optional<Refusal> failure = guarded([&]() -> std::optional<Refusal> {
      step = job_.step(log_.cancel_flag(), report);
      return std::nullopt;
    });
    if (failure) step.refusal = failure;
    std::unique_lock lock(mutex_);
    stepping_ = false;
    if (step.message) outgoing_.push_back(std::move(*step.message));
    if (step.is_last) status_ = grpc::Status::OK;
    if (step.refusal) status_ = to_status(*step.refusal);
    pump(std::move(lock));
  }

  // Starts whatever may start now. Consumes the lock: the last thing that a caller does.
  void pump(std::unique_lock<std::mutex> lock) {
    if (log_.cancelled()) {
      // The message being written stays until OnWriteDone.
      outgoing_.erase(outgoing_.begin() + (writing_ ? 1 : 0), outgoing_.end());
      if (!status_ || status_->ok()) status_ = to_status(cancelled_refusal());
    }
    if (!writing_ && !outgoing_.empty()) {
      writing_ = true;
      StartWrite(&outgoing_.front());
    }
    const size_t ready = outgoing_.size() - (writing_ ? 1 : 0);
    if (!status_ && !stepping_ && ready < kMessagesAhead) {
      stepping_ = true;
      state_.arena.post([this] { step(); });
    }
    const bool finished = status_ && !stepping_ && !writing_;
    lock.unlock();
    if (finished) send(*status_);
  }

  void send(const grpc::Status status) {
    job_.close();
    log_.set_outcome(status, job_.facts());
    Finish(status);
  }

  ServiceState& state_;
  CallLog log_;
  ComputeJob job_;
  HearOut hear_out_;
  Request request_;
  ReadTimeout timeout_;

  std::mutex mutex_;
  std::deque<Response> outgoing_;  // the first is being written while writing_
  bool writing_ = false;
  bool stepping_ = false;
  std::optional<grpc::Status> status_;  // decided; sent once everything before it is
};

}  // namespace

grpc::ServerBidiReactor<Request, Response>* new_compute_call(ServiceState& state,
                                                             grpc::CallbackServerContext& context) {
  return new ComputeCall(state, context);
}

}  // namespace barycast::server
