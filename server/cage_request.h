#pragma once

// From a decoded cage to its shared index: digest, comparison with what the client expected, cache, and
// at most one build. Linear in the cage, plus checks and winding numbers where the cache misses.
// Runs on the compute arena.

#include <functional>
#include <optional>
#include <string>

#include "cage_cache.h"
#include "decode.h"

namespace barycast::server {

// Errors: a digest that is not the expected one. `expected_path` names the field that held it.
Status check_digest(const CageDigest& actual, const std::optional<CageDigest>& expected,
                    const std::string& expected_path);

// Whether the cage's index could be built, without building it. Errors: those of Cage::create, with paths
// from "cage".
Status check_cage(const CageStorage& storage);

// What a request with tables asks of its cage, whatever else it says.
ResolvedOptions options_of_tables();
// Whether the cage can have tables, without building it. Errors: those of check_cage, and kInvalidArgument at
// "fill_tables".
Status check_tables(const CageStorage& storage);

// Builds the index of `storage` unless the cache holds it or another request builds it. `waiter` is
// called exactly once, see CageCache. Errors: those of Cage::create, with paths from "cage".
CageCache::Found get_index(CageCache& cages, const CageDigest& digest, CageStorage storage, CageCache::Waiter waiter);

}  // namespace barycast::server
