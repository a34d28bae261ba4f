#pragma once

// What a request asks for and what it will cost, decided from its header alone: one set of decisions for
// ComputeCoordinates, which then asks for admission and works, and for EstimateCost, which answers the cost.
// Linear in the cage. Runs on the compute arena.

#include <functional>
#include <optional>
#include <string>
#include <variant>

#include "bind/cost.h"
#include "decode.h"
#include "refusal.h"
#include "request_record.h"
#include "service_state.h"

namespace barycast::server {

// A header whose cage has a name that everybody agrees on.
struct Understood {
  ComputePlan plan;                 // its cage is moved to `cage`
  std::optional<CageStorage> cage;  // sent along
  CageDigest digest;
};
// `metadata_digest`: the x-cage-digest that came with the call, or empty. Errors: those of the plan, and
// kInvalidArgument where a digest does not match.
Result<Understood> understand(Result<ComputePlan> plan, const std::string& metadata_digest);

struct RequestCost {
  uint64_t memory_bytes = 0;    // as expected
  uint64_t admitted_bytes = 0;  // as promised by admission: the worst case, and the blocks on their way
  uint64_t samples = 0;
  uint64_t output_bytes = 0;
  uint32_t block_rows = 0;
};
// Of a cage that was sent along: as if it were closed, for that takes a look at every element.
BindingSize size_of(const CageStorage& cage);
BindingSize size_of(const CageIndex& index, const ResolvedOptions& options);
// `cage_size`: of the cage; the rest is filled in. Errors: kInvalidArgument (options that do not fit the
// cage's dimension), kResourceExhausted (more memory than one request may have).
Result<RequestCost> price(const ComputePlan& plan, BindingSize cage_size, const Limits& limits, int threads);

// What filling the cage's tables takes while it lasts, with admission's margin; what stays is the cache's. Errors:
// kResourceExhausted (more memory than one request may have).
Result<uint64_t> price_tables(const CageStorage& cage, const Limits& limits, int threads);

Refusal refuse(Error error);
// FAILED_PRECONDITION with the digest: upload it.
Refusal missing_cage(const CageDigest& digest);

// EstimateCost: everything that ComputeCoordinates would refuse but for being busy, and nothing done. `then`
// is called exactly once, later where another request builds the cage. `facts` outlives that.
void estimate_cost(ServiceState& state, Result<ComputePlan> plan, const std::string& metadata_digest,
                   RequestFacts& facts, std::function<void(std::variant<RequestCost, Refusal>)> then);

}  // namespace barycast::server
