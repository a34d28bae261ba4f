#include "cage_request.h"

#include <fmt/format.h>

namespace barycast::server {
namespace {

// Whatever their origin, users see paths that start at the cage.
Error from_cage(Error error) {
  if (!error.field.starts_with("cage")) error.field = error.field.empty() ? "cage" : "cage." + error.field;
  return error;
}

}  // namespace

Status check_digest(const CageDigest& actual, const std::optional<CageDigest>& expected,
                    const std::string& expected_path) {
  if (!expected || *expected == actual) return Done{};
  return invalid_argument(
      expected_path, fmt::format("{} of {} bytes, but the cage's digest is {} of {} bytes; compute it over the "
                                 "canonical bytes, or leave it out",
                                 hexadecimal(*expected), expected->size_bytes, hexadecimal(actual), actual.size_bytes));
}

Status check_cage(const CageStorage& storage) {
  const Status sound = CageIndex::check(storage.input());
  return sound.ok() ? sound : Status(from_cage(sound.error()));
}

ResolvedOptions options_of_tables() {
  Options options;
  options.tables = true;
  return resolve(options, false).value();
}

Status check_tables(const CageStorage& storage) {
  const Status suits = CageIndex::check_tables(storage.input());
  if (suits.ok()) return suits;
  if (suits.error().field != "tables") return from_cage(suits.error());
  return invalid_argument("fill_tables", suits.error().message);
}

CageCache::Found get_index(CageCache& cages, const CageDigest& digest, CageStorage storage, CageCache::Waiter waiter) {
  const auto build = [&storage]() -> Result<CageCache::Index> {
    Result<CageCache::Index> index = CageIndex::create(storage.input());
    return index.ok() ? index : from_cage(index.error());
  };
  return cages.get(digest, build, std::move(waiter));
}

}  // namespace barycast::server
