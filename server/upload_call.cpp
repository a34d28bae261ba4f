#include "upload_call.h"

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <limits>

#include "cage_request.h"
#include "call_log.h"
#include "encode.h"
#include "hear_out.h"
#include "read_timeout.h"
#include "request_cost.h"

namespace barycast::server {
namespace {

// What a serialized Cage may be larger than its canonical bytes: tags and lengths of a dozen fields.
constexpr uint64_t kSerializedExtraBytes = 4096;
// Tables that every thread of the arena makes in a turn: some ten or twenty milliseconds, as computations take, so that
// neither waits for long, nor does a cancellation.
constexpr size_t kTablesPerTurn = 128;

class UploadCall final : public grpc::ServerReadReactor<v1::UploadCageRequest> {
 public:
  UploadCall(ServiceState& state, grpc::CallbackServerContext& context, v1::UploadCageResponse& response)
      : state_(state), log_(state, Method::kUploadCage, context), response_(response), hear_out_(context) {
    if (std::optional<Refusal> refusal = admit()) {
      refuse(*refusal);
    } else {
      read();
    }
  }

  void OnReadDone(bool ok) override {
    if (!timeout_.stop()) return;
    if (hear_out_.begun()) return ok ? hear() : send(hear_out_.status());
    if (!ok) return state_.arena.post([this] { build(); });
    if (const std::optional<Refusal> refusal = guarded([this] { return collect(); })) return refuse(*refusal);
    read();
  }

  void OnCancel() override { log_.mark_cancelled(); }
  void OnDone() override { delete this; }

 private:
  std::optional<Refusal> admit() {
    if (std::optional<Refusal> refusal = closed(state_)) return refusal;
    // Twice the limit: the bytes, and the arrays decoded from them.
    return enter(2 * state_.limits.cage_bytes_max);
  }

  std::optional<Refusal> enter(uint64_t bytes) {
    auto entered = state_.admission.enter(bytes);
    if (Refusal* busy = std::get_if<Refusal>(&entered)) return std::move(*busy);
    ticket_ = std::move(std::get<std::unique_ptr<Admission::Ticket>>(entered));
    return std::nullopt;
  }

  void read() {
    const auto limit = state_.limits.receive_idle_max;
    // The read that is still under way ends with the call.
    timeout_.watch(
        limit, [this] { StartRead(&request_); }, [this, limit] { conclude(silent_refusal(limit)); });
  }

  // Before the end of the input, with no read under way.
  void refuse(const Refusal& refusal) {
    if (!hear_out_.wanted()) return conclude(refusal);
    ticket_.reset();
    bytes_ = {};
    hear_out_.begin(to_status(refusal));
    hear();
  }

  void hear() {
    request_ = {};
    hear_out_.read(
        timeout_, log_.cancelled(), [this] { StartRead(&request_); },
        [this](const grpc::Status& status) { send(status); });
  }

  std::optional<Refusal> collect() {
    if (request_.has_expected_digest()) {
      if (!first_)
        return Refusal{invalid_argument("expected_digest", "in a later message; send it with the first piece"), {}, {}};
      Result<CageDigest> expected = decode_digest(request_.expected_digest(), "expected_digest");
      if (!expected) return Refusal{expected.error(), {}, {}};
      expected_ = *expected;
    }
    if (request_.fill_tables()) {
      if (!first_)
        return Refusal{invalid_argument("fill_tables", "in a later message; set it with the first piece"), {}, {}};
      fill_tables_ = true;
    }
    first_ = false;
    if (bytes_.size() + request_.piece().size() > state_.limits.cage_bytes_max + kSerializedExtraBytes) {
      return Refusal{
          {ErrorCode::kResourceExhausted, "cage",
           fmt::format("more than this server's limit of {} bytes; use a coarser cage", state_.limits.cage_bytes_max)},
          {},
          {}};
    }
    bytes_ += request_.piece();
    return std::nullopt;
  }

  // On the arena.
  void build() {
    if (log_.cancelled()) return conclude(cancelled_refusal());
    CageStorage cage;
    CageDigest digest;
    if (const std::optional<Refusal> refusal = guarded([&] { return open(cage, digest); })) return conclude(*refusal);
    get_index(state_.cages, digest, std::move(cage), [this](Result<CageCache::Index> index, CageCache::Found found) {
      facts_.cache_hit = found == CageCache::Found::kHit;
      if (!index) return conclude({index.error(), {}, {}});
      index_ = std::move(*index);
      fill_tables_ ? prepare_tables() : answer();
    });
  }

  void prepare_tables() {
    // What follows the end of the call must not touch it.
    index_->prepare(options_of_tables(), [this](const Status& built) {
      if (!built) return conclude({built.error(), {}, {}});
      state_.arena.post([this] {
        fill([this] { places_ = index_->missing_tables(std::numeric_limits<size_t>::max(), log_.cancel_flag()); });
      });
    });
  }

  // A turn. Everything that was made is kept, and counted, whatever becomes of the call.
  void fill(const std::function<void()>& work) {
    const std::optional<Refusal> failure = guarded([&]() -> std::optional<Refusal> {
      work();
      return std::nullopt;
    });
    state_.cages.recount(*index_);
    if (failure) return conclude(*failure);
    if (log_.cancelled()) return conclude(cancelled_refusal());
    // A cage that has outgrown the cache is not filled any further.
    if (filled_ == places_.size() || !state_.cages.contains(index_->digest())) return answer();
    state_.arena.post([this] { fill([this] { fill_some(); }); });
  }

  void fill_some() {
    const size_t turn = kTablesPerTurn * static_cast<size_t>(state_.arena.threads());
    const auto some = std::span(places_).subspan(filled_, std::min(turn, places_.size() - filled_));
    // Where others took the room meanwhile there is none for the rest.
    filled_ = index_->fill_tables(some, log_.cancel_flag()) > 0 ? filled_ + some.size() : places_.size();
  }

  void answer() {
    if (!state_.cages.contains(index_->digest())) {
      const size_t bytes = index_->bytes();
      return conclude(
          {fill_tables_
               ? Error{ErrorCode::kResourceExhausted, "fill_tables",
                       fmt::format("with its tables the cage's {} bytes found no place in this server's cache; leave "
                                   "this out",
                                   bytes)}
               : Error{ErrorCode::kResourceExhausted, "cage",
                       fmt::format("its {} bytes of acceleration structures found no place in this server's cache; "
                                   "send it inline with the request",
                                   bytes)},
           {},
           {}});
    }
    *response_.mutable_digest() = encode_digest(index_->digest());
    for (const Warning& warning : index_->warnings()) *response_.add_warnings() = encode_warning(warning);
    response_.set_tables(index_->table_count());
    send(grpc::Status::OK);
  }

  std::optional<Refusal> open(CageStorage& cage, CageDigest& digest) {
    Result<CageStorage> decoded = decode_cage_bytes(bytes_, state_.limits);
    bytes_ = {};
    if (!decoded) return Refusal{decoded.error(), {}, {}};
    cage = std::move(*decoded);
    digest = barycast::digest(cage.input());
    facts_.cage = hexadecimal(digest);
    facts_.control_vertices = cage.control_vertex_count();
    if (Status same = check_digest(digest, expected_, "expected_digest"); !same) return Refusal{same.error(), {}, {}};
    return fill_tables_ ? admit_tables(cage) : std::nullopt;
  }

  // The pieces are gone, and a cage that has tables is small: what filling takes is admitted in their stead.
  std::optional<Refusal> admit_tables(const CageStorage& cage) {
    if (Status suits = check_tables(cage); !suits) return Refusal{suits.error(), {}, {}};
    const Result<uint64_t> bytes = price_tables(cage, state_.limits, state_.arena.threads());
    if (!bytes) return Refusal{bytes.error(), {}, {}};
    ticket_.reset();
    return enter(*bytes);
  }

  void conclude(const Refusal& refusal) { send(to_status(refusal)); }

  // The last thing done with `this`.
  void send(const grpc::Status& status) {
    places_ = {};
    index_.reset();
    ticket_.reset();
    log_.set_outcome(status, facts_);
    Finish(status);
  }

  ServiceState& state_;
  CallLog log_;
  v1::UploadCageResponse& response_;
  std::unique_ptr<Admission::Ticket> ticket_;
  v1::UploadCageRequest request_;
  ReadTimeout timeout_;
  HearOut hear_out_;
  bool first_ = true, fill_tables_ = false;
  std::optional<CageDigest> expected_;
  std::string bytes_;
  CageCache::Index index_;
  std::vector<const BallLeaf*> places_;  // of tables to make
  size_t filled_ = 0;
  RequestFacts facts_;
};

}  // namespace

grpc::ServerReadReactor<v1::UploadCageRequest>* new_upload_call(ServiceState& state,
                                                                grpc::CallbackServerContext& context,
                                                                v1::UploadCageResponse& response) {
  return new UploadCall(state, context, response);
}

}  // namespace barycast::server
