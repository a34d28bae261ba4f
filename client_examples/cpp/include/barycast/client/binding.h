#pragma once

// A binding: the rows of n points with respect to a cage of v control vertices as one sparse matrix, how
// it was computed, posing with it, and its file. Plain data, owned; reading it is thread-safe.
// `deform` costs one product with the sparse matrix; `save` writes an .npz that scipy.sparse.load_npz and
// the Python command line read. All failures are values (result.h).

#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "barycast/client/options.h"
#include "barycast/client/result.h"

namespace barycast::client {

// Of the output type that was asked for.
using Reals = std::variant<std::vector<float>, std::vector<double>>;

// Bits of a row's flag byte; see barycast/v1/barycast.proto.
enum RowFlag : uint8_t {
  kOnCage = 1,
  kOutside = 2,
  kFewSamples = 4,
  kNoSamples = 8,
  kRankDeficient = 16,
};

struct Warning {
  std::string field;
  std::string message;
};

// Rows that carry each flag.
struct RowCounts {
  uint64_t on_cage = 0, outside = 0, few_samples = 0, no_samples = 0, rank_deficient = 0;
};

// How a computation was understood and how it went.
struct Report {
  uint32_t dimension = 0;
  uint64_t points = 0;
  uint64_t control_vertices = 0;
  uint64_t entries = 0;
  ComputeOptions options;  // as resolved by the server, every field set
  RowCounts rows;
  // Of the last attempt alone, where a broken one was resumed.
  uint64_t samples = 0, walk_steps = 0, walks_capped = 0, walks_discarded = 0, walk_reentries = 0;
  uint64_t rows_above_target = 0;                       // whose standard error is
  double linear_precision_error_max = 0;                // before rounding to the output type, in diagonals
  std::vector<std::pair<std::string, double>> seconds;  // the server's, by stage; "total" is the client's wall time
  bool cage_cache_hit = false;
  uint32_t numerics_version = 0;  // never mix rows of different ones
  std::string build_version;      // set by Client::bind
  std::vector<Warning> warnings;
  std::vector<uint64_t> resumed_rows;  // where the computation went on after a lost connection
};

struct Binding {
  std::vector<uint64_t> offsets = {0};  // n + 1: row i has the entries offsets[i] ... offsets[i + 1] - 1
  std::vector<uint32_t> indices;        // nnz: control vertices, ascending within a row
  Reals values;                         // nnz; rows sum to one
  Reals gradients;                      // nnz x d in the order of values, or empty
  std::vector<uint8_t> flags;           // n, bits of RowFlag
  std::vector<float> errors;            // n x 2: standard error, 95 % bound, of noise and not of bias; or empty
  std::string cage_digest;              // hexadecimal
  Report report;

  size_t point_count() const { return offsets.size() - 1; }
  size_t control_vertex_count() const { return report.control_vertices; }
};

// n x d: the points for posed control vertices (v x d, row-major; d need not be the bound cage's). Evaluated about the
// centre c of the posed cage, c + W (V - c): rows sum to one, so any c gives the same points, and this one keeps
// float32's rounding relative to the cage's size instead of its distance from the origin.
// Errors: another number of control vertices than were bound, a position that is not finite.
Result<std::vector<double>> deform(const Binding& binding, std::span<const double> posed, uint32_t dimension = 3);

// The report as JSON text, in ASCII, with the keys of the Python client's.
std::string to_json(const Report& report);

// Whether a file can be put at path, so that long work can ask first. Errors: it cannot, or it is one of the inputs, by
// whatever path.
Status check_output(const std::string& path, const std::vector<std::string>& inputs = {});

// Writes the binding as .npz; whole or not at all. Errors: the file cannot be written.
Status save(const Binding& binding, const std::string& path);

}  // namespace barycast::client
