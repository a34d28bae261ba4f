#include "request_cost.h"

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
// Encoded blocks that exist at once: one being written (as a message and as the transport's copy), one ready.
constexpr uint64_t kBlocksOnTheirWay = 3;

uint32_t choose_block_rows(const ComputePlan& plan, const BindingSize& size, const Limits& limits) {
  // Asked before the cage is known to be sound: it may have no vertices at all.
  const uint64_t row_bytes =
      std::max<uint64_t>(1, size.control_vertices * entry_bytes(size.dimension, plan.options.gradients, plan.float64));
  const bool asked = plan.block_rows != 0;
  const uint64_t fit = std::max<uint64_t>(1, (asked ? kBlockBytesMax : kBlockBytesDefault) / row_bytes);
  const uint32_t wanted = asked ? plan.block_rows : std::min(kBlockRowsDefault, limits.block_rows_max);
  return static_cast<uint32_t>(std::min<uint64_t>(wanted, fit));
}

}  // namespace

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

Result<Understood> understand(Result<ComputePlan> plan, const std::string& metadata_digest) {
  if (!plan) return plan.error();
  Understood result{.plan = std::move(*plan), .cage = {}, .digest = {}};
  result.cage = std::exchange(result.plan.cage, std::nullopt);
  result.digest = result.cage ? barycast::digest(result.cage->input()) : *result.plan.digest;
  if (Status same = check_digest(result.digest, result.plan.digest, "header.expected_digest"); !same)
    return same.error();
  if (!metadata_digest.empty() && metadata_digest != hexadecimal(result.digest)) {
    return invalid_argument(
        "metadata.x-cage-digest",
        fmt::format("is not the cage's digest, {}; send that, or leave it out", hexadecimal(result.digest)));
  }
  return result;
}

BindingSize size_of(const CageStorage& cage) {
  return {.dimension = cage.dimension,
          .control_vertices = cage.control_vertex_count(),
          .stencil_max = cage.stencil_max(),
          .elements = cage.element_count(),
          .triangles = surface_triangles(cage.input())};
}

BindingSize size_of(const CageIndex& index, const ResolvedOptions& options) {
  BindingSize size{.dimension = index.dimension(),
                   .control_vertices = index.control_vertex_count(),
                   .stencil_max = index.stencil_max(),
                   .elements = index.element_count(),
                   .triangles = index.surface_triangles()};
  if (options.estimator == Estimator::kPredicted) size.closed = index.is_closed();
  return size;
}

Result<RequestCost> price(const ComputePlan& plan, BindingSize size, const Limits& limits, int threads) {
  const ResolvedOptions options = settle(plan.options, size.dimension, size.control_vertices, size.triangles);
  if (const Status fits = check_dimension(options, size.dimension); !fits)
    return invalid_argument("header.output." + fits.error().field, fits.error().message);
  size.points = plan.counts.points;
  size.faces = plan.counts.faces;
  size.face_corners = plan.counts.corners;
  size.threads = static_cast<uint64_t>(threads);
  RequestCost cost;
  cost.block_rows = choose_block_rows(plan, size, limits);
  size.block_rows = cost.block_rows;
  const uint64_t per_entry = entry_bytes(size.dimension, options.gradients, plan.float64);
  const uint64_t block_bytes_max =
      std::min(size.block_rows, size.points) * (row_bytes(plan.errors) + size.control_vertices * per_entry);
  cost.memory_bytes = estimate_memory_bytes(size, options);
  cost.admitted_bytes = bound_memory_bytes(size, options) + kBlocksOnTheirWay * block_bytes_max;
  cost.samples = estimate_samples(size, options);
  const uint64_t blocks = (size.points + size.block_rows - 1) / size.block_rows;
  cost.output_bytes = estimate_entries(size, options) * per_entry + size.points * row_bytes(plan.errors) + blocks * 4;
  if (cost.admitted_bytes <= limits.request_bytes_max) return cost;
  return Error{ErrorCode::kResourceExhausted, "header.queries",
               fmt::format("up to {} bytes of working memory, more than this server's limit of {}; cut the points into "
                           "several requests, or set denoise to none",
                           cost.admitted_bytes, limits.request_bytes_max)};
}

Result<uint64_t> price_tables(const CageStorage& cage, const Limits& limits, int threads) {
  // As a request of a single point would: a prediction, and what every thread works with.
  BindingSize size = size_of(cage);
  size.points = 1;
  size.threads = static_cast<uint64_t>(threads);
  const uint64_t bytes = bound_memory_bytes(size, options_of_tables());
  if (bytes <= limits.request_bytes_max) return bytes;
  return Error{ErrorCode::kResourceExhausted, "fill_tables",
               fmt::format("up to {} bytes of working memory, more than this server's limit of {}; leave it out", bytes,
                           limits.request_bytes_max)};
}

void estimate_cost(ServiceState& state, Result<ComputePlan> plan, const std::string& metadata_digest,
                   RequestFacts& facts, std::function<void(std::variant<RequestCost, Refusal>)> then) {
  Result<Understood> understood = understand(std::move(plan), metadata_digest);
  if (!understood) return then(refuse(understood.error()));
  facts.cage = hexadecimal(understood->digest);
  facts.points = understood->plan.counts.points;
  facts.faces = understood->plan.counts.faces;
  const auto answer = [&limits = state.limits, threads = state.arena.threads(), plan = understood->plan, &facts,
                       then](const BindingSize& size) {
    facts.control_vertices = size.control_vertices;
    const Result<RequestCost> cost = price(plan, size, limits, threads);
    cost.ok() ? then(*cost) : then(refuse(cost.error()));
  };
  if (understood->cage) {
    // In the order of ComputeCoordinates: what is too large is not looked at.
    BindingSize size = size_of(*understood->cage);
    const bool fits = price(understood->plan, size, state.limits, state.arena.threads()).ok();
    if (const Status sound = fits ? check_cage(*understood->cage) : Status(Done{}); !sound)
      return then(refuse(sound.error()));
    const ResolvedOptions options =
        settle(understood->plan.options, size.dimension, size.control_vertices, size.triangles);
    if (const Status suits = fits ? CageIndex::check_estimator(understood->cage->input(), options) : Status(Done{});
        !suits)
      return then(refuse(at_options(suits.error())));
    if (fits && options.estimator == Estimator::kPredicted)
      size.closed = CageIndex::is_closed(understood->cage->input()).value();
    return answer(size);
  }
  const auto waiter = [answer, then, &facts, options = understood->plan.options](Result<CageCache::Index> index,
                                                                                 CageCache::Found found) {
    facts.cache_hit = found == CageCache::Found::kHit;
    if (!index.ok()) return then(refuse(index.error()));
    const Status suits = (*index)->check_estimator((*index)->settle(options));
    suits.ok() ? answer(size_of(**index, options)) : then(refuse(at_options(suits.error())));
  };
  if (state.cages.find(understood->digest, waiter) == CageCache::Found::kMissing)
    then(missing_cage(understood->digest));
}

}  // namespace barycast::server
