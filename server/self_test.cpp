#include "self_test.h"

#include <fmt/format.h>

#include <array>
#include <cmath>

#include "bind/binding.h"
#include "kinds.h"

namespace barycast::server {
namespace {

Error failed(const std::string& what) {
  return {ErrorCode::kInternal, "", "self-test failed: " + what};
}

// Rows promise linear precision to 1e-12 in the cage's frame; here that is the caller's within a factor.
constexpr double kTolerance = 1e-11;

// The coordinates of one inner point.
Status test_kind(const std::shared_ptr<const CageIndex>& index, CoordinateKind kind) {
  Options choices;
  choices.coordinates = kind;
  choices.prune_below = 0.0;
  const Result<ResolvedOptions> options = resolve(choices, false);
  if (!options) return failed(options.error().text());
  const std::array<double, 4> expected = {0.4, 0.1, 0.2, 0.3};  // of the point (0.1, 0.2, 0.3)
  QueryInput query;
  query.points = {expected[1], expected[2], expected[3]};
  const Result<RowBlock> rows = bind_all(index, std::move(query), *options);
  if (!rows) return failed(rows.error().text());
  if (rows->row_count() != 1 || rows->values.size() != expected.size())
    return failed(fmt::format("{} coordinates of a tetrahedron are not one row of four entries", kind_name(kind)));
  for (size_t i = 0; i < expected.size(); ++i) {
    if (!(std::abs(rows->values[i] - expected[i]) <= kTolerance)) {
      return failed(fmt::format("{} coordinate {} of a tetrahedron is {}, expected {}", kind_name(kind), i,
                                rows->values[i], expected[i]));
    }
  }
  return Done{};
}

}  // namespace

Status self_test() {
  const std::array<double, 12> corners = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
  const std::array<uint32_t, 12> faces = {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3};
  CageInput input;
  input.control_vertices = corners;
  input.triangles = faces;
  const Result<std::shared_ptr<const CageIndex>> index = CageIndex::create(input);
  if (!index) return failed(index.error().text());
  for (const CoordinateKind kind : built_kinds()) {
    if (Status tested = test_kind(*index, kind); !tested) return tested;
  }
  return Done{};
}

}  // namespace barycast::server
