#include "compute_job.h"

#include <utility>

#include "cage_request.h"
#include "encode.h"

namespace barycast::server {
namespace {

constexpr std::chrono::milliseconds kReportInterval{100};

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
  Result<Understood> understood = understand(decode_header(header, state_.limits), metadata_digest_);
  if (!understood) return refuse(understood.error());
  plan_ = std::move(understood->plan);
  cage = std::move(understood->cage);
  digest = understood->digest;
  facts_.cage = hexadecimal(digest);
  facts_.points = plan_->counts.points;
  facts_.faces = plan_->counts.faces;
  return cage ? admit(size_of(*cage)) : std::nullopt;
}

std::optional<Refusal> ComputeJob::use_index(Result<CageCache::Index> index, bool cache_hit) {
  if (!index) return refuse(index.error());
  plan_->options = (*index)->settle(plan_->options);
  if (const Status fits = (*index)->check_estimator(plan_->options); !fits) return refuse(at_options(fits.error()));
  index_ = std::move(*index);
  facts_.cache_hit = cache_hit;
  if (!ticket_) {
    if (std::optional<Refusal> refusal = admit(size_of(*index_, plan_->options))) return refusal;
  }
  assembler_.emplace(plan_->counts, index_->dimension());
  cage_s_ = std::chrono::duration<double>(Clock::now() - cage_start_).count();
  return std::nullopt;
}

std::optional<Refusal> ComputeJob::admit(const BindingSize& cage_size) {
  facts_.control_vertices = cage_size.control_vertices;
  const Result<RequestCost> cost = price(*plan_, cage_size, state_.limits, state_.arena.threads());
  if (!cost) return refuse(cost.error());
  block_rows_ = cost->block_rows;
  auto entered = state_.admission.enter(cost->admitted_bytes);
  if (Refusal* busy = std::get_if<Refusal>(&entered)) return std::move(*busy);
  ticket_ = std::move(std::get<std::unique_ptr<Admission::Ticket>>(entered));
  return std::nullopt;
}

void ComputeJob::prepare(Then then) {
  if (!plan_) return then(refuse(invalid_argument("header", "missing; the first message must be the header")));
  // What follows `then` must not touch this job.
  index_->prepare(plan_->options, [this, then, start = Clock::now()](const Status& built) {
    then(guarded([&]() -> std::optional<Refusal> {
      if (!built) return refuse(built.error());
      state_.cages.recount(*index_);
      cage_s_ += std::chrono::duration<double>(Clock::now() - start).count();
      return std::nullopt;
    }));
  });
}

std::variant<ComputeJob::Response, Refusal> ComputeJob::begin(const std::atomic<bool>& cancel) {
  Result<QueryInput> queries = assembler_->take();
  if (!queries) return refuse(queries.error());
  Result<std::unique_ptr<Binding>> binding = Binding::create(
      index_, std::move(*queries),
      {.options = plan_->options, .block_rows = block_rows_, .first_row = plan_->first_row, .kernels = &state_.kernels},
      cancel);
  if (!binding) return refuse(binding.error());
  // Points outside may have asked for another prediction.
  if (plan_->options.estimator == Estimator::kPredicted) state_.cages.recount(*index_);
  if (const Status same = check_resumed_smoothing(*plan_, (*binding)->smoothing_time()); !same)
    return refuse(same.error());
  binding_ = std::move(*binding);
  return encode_header({.digest = index_->digest(),
                        .cage_cache_hit = facts_.cache_hit.value_or(false),
                        .options = plan_->options,
                        .smoothing_time = binding_->smoothing_time(),
                        .float64 = plan_->float64,
                        .errors = plan_->errors,
                        .block_rows = block_rows_,
                        .control_vertex_count = index_->control_vertex_count()});
}

ComputeJob::Step ComputeJob::step(const std::atomic<bool>& cancel, bool report) {
  Step step;
  state_.counters.steps.fetch_add(1, std::memory_order_relaxed);
  const Binding::Step done = binding_->advance(cancel);
  // Every piece of work may have made some of the prediction's cells, or of the cage's tables.
  if (plan_->options.estimator == Estimator::kPredicted) state_.cages.recount(*index_);
  switch (done) {
    case Binding::Step::kWorking:
      if (report) step.message = progress_message();
      break;
    case Binding::Step::kBlock:
      step.message =
          encode_rows(binding_->take_block(),
                      {.dimension = index_->dimension(), .float64 = plan_->float64, .errors = plan_->errors});
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
  if (binding_) {
    summary_ = binding_->summary();
    facts_.stages = {cage_s_,
                     summary_.solving_s,
                     summary_.sampling_s,
                     summary_.smoothing_factor_s,
                     summary_.smoothing_solve_s,
                     summary_.rows_s};
  }
  facts_.samples = summary_.samples;
  facts_.rows = summary_.rows;
  facts_.entries = summary_.entries;
  binding_.reset();
  assembler_.reset();
  index_.reset();
  ticket_.reset();
}

}  // namespace barycast::server
