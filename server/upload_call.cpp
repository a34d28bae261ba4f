#include "upload_call.h"

#include <fmt/format.h>

#include "cage_request.h"
#include "call_log.h"
#include "encode.h"
#include "read_timeout.h"

namespace barycast::server {
namespace {

// What a serialized Cage may be larger than its canonical bytes: tags and lengths of a dozen fields.
constexpr uint64_t kSerializedExtraBytes = 4096;

class UploadCall final : public grpc::ServerReadReactor<v1::UploadCageRequest> {
 public:
  UploadCall(ServiceState& state, grpc::CallbackServerContext& context, v1::UploadCageResponse& response)
      : state_(state), log_(state, Method::kUploadCage, context), response_(response) {
    if (std::optional<Refusal> refusal = admit()) {
      conclude(*refusal);
    } else {
      read();
    }
  }

  void OnReadDone(bool ok) override {
    if (!timeout_.stop()) return;
    if (!ok) return state_.arena.post([this] { build(); });
    if (const std::optional<Refusal> refusal = guarded([this] { return collect(); })) return conclude(*refusal);
    read();
  }

  void OnCancel() override { log_.mark_cancelled(); }
  void OnDone() override { delete this; }

 private:
  std::optional<Refusal> admit() {
    if (std::optional<Refusal> refusal = closed(state_)) return refusal;
    // Twice the limit: the bytes, and the arrays decoded from them.
    auto entered = state_.admission.enter(2 * state_.limits.cage_bytes_max);
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

  std::optional<Refusal> collect() {
    if (request_.has_expected_digest()) {
      if (!first_)
        return Refusal{invalid_argument("expected_digest", "in a later message; send it with the first piece"), {}, {}};
      Result<CageDigest> expected = decode_digest(request_.expected_digest(), "expected_digest");
      if (!expected) return Refusal{expected.error(), {}, {}};
      expected_ = *expected;
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
      if (!state_.cages.contains((*index)->digest())) {
        return conclude({{ErrorCode::kResourceExhausted, "cage",
                          fmt::format("its {} bytes of acceleration structures found no place in this server's cache; "
                                      "send it inline with the request",
                                      (*index)->bytes())},
                         {},
                         {}});
      }
      *response_.mutable_digest() = encode_digest((*index)->digest());
      for (const Warning& warning : (*index)->warnings()) *response_.add_warnings() = encode_warning(warning);
      send(grpc::Status::OK);
    });
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
    return std::nullopt;
  }

  void conclude(const Refusal& refusal) { send(to_status(refusal)); }

  // The last thing done with `this`.
  void send(const grpc::Status& status) {
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
  bool first_ = true;
  std::optional<CageDigest> expected_;
  std::string bytes_;
  RequestFacts facts_;
};

}  // namespace

grpc::ServerReadReactor<v1::UploadCageRequest>* new_upload_call(ServiceState& state,
                                                                grpc::CallbackServerContext& context,
                                                                v1::UploadCageResponse& response) {
  return new UploadCall(state, context, response);
}

}  // namespace barycast::server
