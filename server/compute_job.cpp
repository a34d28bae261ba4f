#include "compute_job.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "cage_request.h"
#include "encode.h"

namespace barycast::server {
namespace {

// Where the client leaves it to us, even dense rows stay below the 4 MiB that gRPC clients accept unless
// told otherwise; where it does not, two blocks on their way must not outweigh the request itself.
constexpr uint64_t kBlockBytesDefault = 3ull << 20;
constexpr uint64_t kBlockBytesMax = 64ull << 20;
constexpr uint32_t kBlockRowsDefault = 4096;
constexpr std::chrono::milliseconds kReportInterval{100};

Refusal refuse(Error error) {
  return {.error = std::move(error), .missing_digest = {}, .retry_after_ms = {}};
}

Refusal missing_cage(const CageDigest& digest) {
  Refusal refusal =
      refuse({ErrorCode::kFailedPrecondition, "header.cage_digest",
              fmt::format("this server does not hold cage {}; upload it, or send it inline", hexadecimal(digest))});
  refusal.missing_digest = hexadecimal(digest);
  return refusal;
}

}  // namespace

ComputeJob::ComputeJob(ServiceState& state, std::string metadata_digest)
    : state_(state), metadata_digest_(std::move(metadata_digest)) {}

void ComputeJob::receive(const v1::ComputeCoordinatesRequest& message, Then then) {
  if (message.has_header() && !plan_) return start(message.header(), std::move(then));
  then(guarded([&] { return collect(message); }));
}

std::optional<Refusal> ComputeJob::collect(const v1::ComputeCoordinatesRequest& message) {
  using Message = v1::ComputeCoordinatesRequest;
  if (message.has_header()) return refuse(invalid_argument("header", "a second one; send one header, first"));
  if (message.message_case() == Message::MESSAGE_NOT_SET)
    return refuse(invalid_argument("message", "neither header, points nor faces; set one of them"));
  if (!plan_) return refuse(invalid_argument("header", "missing; the first message must be the header"));
  const Status added =
      message.message_case() == Message::kPoints ? assembler_->add(message.points()) : assembler_->add(message.faces());
  return added.ok() ? std::nullopt : std::optional(refuse(added.error()));
}

void ComputeJob::start(const v1::ComputeHeader& header, Then then) {
  cage_start_ = Clock::now();
  std::optional<CageStorage> cage;
  CageDigest digest;
  if (std::optional<Refusal> refusal = guarded([&] { return open(header, cage, digest); }))
    return then(std::move(refusal));
  // What follows `then` must not touch this job: the answer may already be on its way, and the job gone.
  const auto waiter = [this, then](Result<CageCache::Index> index, CageCache::Found found) {
    then(guarded([&] { return use_index(std::move(index), found == CageCache::Found::kHit); }));
  };
  if (cage) {
    get_index(state_.cages, digest, std::move(*cage), waiter);
  } else if (state_.cages.find(digest, waiter) == CageCache::Found::kMissing) {
    then(missing_cage(digest));
  }
}

std::optional<Refusal> ComputeJob::open(const v1::ComputeHeader& header, std::optional<CageStorage>& cage,
                                        CageDigest& digest) {
  Result<ComputePlan> plan = decode_header(header, state_.limits);
  if (!plan) return refuse(plan.error());
  plan_ = std::move(*plan);
  cage = std::exchange(plan_->cage, std::nullopt);
  digest = cage ? barycast::digest(cage->input()) : *plan_->digest;
  digest_text_ = hexadecimal(digest);
  if (Status same = check_digest(digest, plan_->digest, "header.expected_digest"); !same) return refuse(same.error());
  if (std::optional<Refusal> refusal = check_metadata(digest)) return refusal;
  if (!cage) return std::nullopt;
  return admit({.dimension = cage->dimension,
                .control_vertices = cage->control_vertex_count(),
                .stencil_max = cage->stencil_max()});
}

std::optional<Refusal> ComputeJob::check_metadata(const CageDigest& digest) const {
  if (metadata_digest_.empty() || metadata_digest_ == hexadecimal(digest)) return std::nullopt;
  return refuse(
      invalid_argument("metadata.x-cage-digest",
                       fmt::format("is not the cage's digest, {}; send that, or leave it out", hexadecimal(digest))));
}

std::optional<Refusal> ComputeJob::use_index(Result<CageCache::Index> index, bool cache_hit) {
  if (!index) return refuse(index.error());
  index_ = std::move(*index);
  cache_hit_ = cache_hit;
  if (!ticket_) {
    if (std::optional<Refusal> refusal = admit({.dimension = index_->dimension(),
                                                .control_vertices = index_->control_vertex_count(),
                                                .stencil_max = index_->stencil_max()}))
      return refusal;
  }
  assembler_.emplace(plan_->counts, index_->dimension());
  cage_s_ = std::chrono::duration<double>(Clock::now() - cage_start_).count();
  return std::nullopt;
}

std::optional<Refusal> ComputeJob::admit(BindingSize size) {
  if (const Status fits = check_dimension(plan_->options, size.dimension); !fits)
    return refuse(invalid_argument("header.output." + fits.error().field, fits.error().message));
  size.points = plan_->counts.points;
  size.face_corners = plan_->counts.corners;
  size.block_rows = choose_block_rows(size.dimension, size.control_vertices);
  size.threads = static_cast<uint64_t>(state_.arena.threads());
  const uint64_t bytes = estimate_memory_bytes(size, plan_->options);
  if (bytes > state_.limits.request_bytes_max) {
    return refuse({ErrorCode::kResourceExhausted, "header.queries",
                   fmt::format("about {} bytes of working memory, more than this server's limit of {}; cut the points "
                               "into several requests, or set denoise to none",
                               bytes, state_.limits.request_bytes_max)});
  }
  auto entered = state_.admission.enter(bytes);
  if (Refusal* busy = std::get_if<Refusal>(&entered)) return std::move(*busy);
  ticket_ = std::move(std::get<std::unique_ptr<Admission::Ticket>>(entered));
  return std::nullopt;
}

uint32_t ComputeJob::choose_block_rows(int dimension, uint64_t control_vertices) const {
  // Asked before the cage is known to be sound: it may have no vertices at all.
  const uint64_t row_bytes =
      std::max<uint64_t>(1, control_vertices * entry_bytes(dimension, plan_->options.gradients, plan_->float64));
  const bool asked = plan_->block_rows != 0;
  const uint64_t fit = std::max<uint64_t>(1, (asked ? kBlockBytesMax : kBlockBytesDefault) / row_bytes);
  const uint32_t wanted = asked ? plan_->block_rows : std::min(kBlockRowsDefault, state_.limits.block_rows_max);
  return static_cast<uint32_t>(std::min<uint64_t>(wanted, fit));
}

std::variant<ComputeJob::Response, Refusal> ComputeJob::end_of_input(const std::atomic<bool>& cancel) {
  if (!plan_) return refuse(invalid_argument("header", "missing; the first message must be the header"));
  Result<QueryInput> queries = assembler_->take();
  if (!queries) return refuse(queries.error());
  const uint32_t block_rows = choose_block_rows(index_->dimension(), index_->control_vertex_count());
  Result<std::unique_ptr<Binding>> binding =
      Binding::create(index_, std::move(*queries),
                      {.options = plan_->options, .block_rows = block_rows, .first_row = plan_->first_row}, cancel);
  if (!binding) return refuse(binding.error());
  binding_ = std::move(*binding);
  return encode_header({.digest = index_->digest(),
                        .cage_cache_hit = cache_hit_,
                        .options = plan_->options,
                        .smoothing_time = binding_->smoothing_time(),
                        .float64 = plan_->float64,
                        .block_rows = block_rows,
                        .control_vertex_count = index_->control_vertex_count()});
}

ComputeJob::Step ComputeJob::step(const std::atomic<bool>& cancel, bool report) {
  Step step;
  state_.counters.steps.fetch_add(1, std::memory_order_relaxed);
  switch (binding_->advance(cancel)) {
    case Binding::Step::kWorking:
      if (report) step.message = progress_message();
      break;
    case Binding::Step::kBlock:
      step.message = encode_rows(binding_->take_block(), index_->dimension(), plan_->float64);
      state_.counters.blocks_produced.fetch_add(1, std::memory_order_relaxed);
      break;
    case Binding::Step::kDone:
      summary_ = binding_->summary();
      step.message = encode_summary(summary_, cage_s_);
      step.is_last = true;
      break;
    case Binding::Step::kCancelled:
      step.refusal = refuse({ErrorCode::kCancelled, "", "cancelled by the client or past its deadline"});
      break;
  }
  return step;
}

std::optional<ComputeJob::Response> ComputeJob::progress_message() {
  const Clock::time_point now = Clock::now();
  if (now - reported_ < kReportInterval) return std::nullopt;
  reported_ = now;
  return encode_progress(binding_->progress());
}

void ComputeJob::close() {
  if (binding_) summary_ = binding_->summary();
  binding_.reset();
  assembler_.reset();
  index_.reset();
  ticket_.reset();
}

std::string ComputeJob::description() const {
  const QueryCounts counts = plan_ ? plan_->counts : QueryCounts{};
  return fmt::format("cage={} cache={} points={} faces={} samples={} rows={} entries={}", digest_text_,
                     cache_hit_ ? "hit" : "miss", counts.points, counts.faces, summary_.samples, summary_.rows,
                     summary_.entries);
}

}  // namespace barycast::server
