#pragma once

// The one entry of the library: cage + query points + options -> sparse rows, in order.
//
// A Binding is pulled: `advance` does a bounded piece of work (tens of milliseconds) on the threads of
// the calling task arena and says what came of it. Between two calls nothing runs and nothing waits, so
// a service can interleave many bindings on one arena, stop one at any time, and let a slow reader
// hold back its own binding only. `bind_all` is the one-shot form.
//
//   auto binding = Binding::create(index, std::move(queries), options);
//   while (true) switch (binding->advance(cancel)) {
//     case Binding::Step::kBlock: write(binding->take_block()); break;
//     ...
//
// Memory without denoising: a few blocks. With denoising: the rows of the whole query set.
// A Binding is used from one thread at a time; it uses the arena's threads itself. Rows do not depend
// on the number of threads, the block size, or on `advance`'s cutting into pieces.

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "base/result.h"
#include "base/warning.h"
#include "bind/cage_index.h"
#include "bind/options.h"
#include "estimate/row_flags.h"

namespace barycast {

class KernelCache;

// The points to bind, and the faces between them. Points are in the cage's units and frame.
struct QueryInput {
  std::vector<double> points;          // n x d, row-major
  std::vector<uint32_t> face_offsets;  // k + 1, starting at 0; or empty
  std::vector<uint32_t> face_corners;  // indices of points
};

// Consecutive rows, compressed: row first_row + i has the entries offsets[i] ... offsets[i + 1] - 1,
// ordered by control vertex.
struct RowBlock {
  uint64_t first_row = 0;
  std::vector<uint32_t> offsets;  // rows + 1
  std::vector<uint32_t> indices;  // nnz
  std::vector<double> values;     // nnz
  std::vector<double> gradients;  // nnz x d, per unit of the caller's length; empty unless asked for
  std::vector<uint8_t> flags;     // rows
  // rows x 2, with a target error: the standard error of a row's values, and what they are off by at most in 95 of 100
  // rows (Randomizations::Error); of noise, not of bias, and before pruning.
  std::vector<float> errors;
  uint64_t row_count() const { return flags.size(); }
};

enum class Stage { kSolving, kSampling, kSmoothing, kRows };

struct Progress {
  Stage stage = Stage::kSampling;
  uint64_t done = 0;  // of `total` units of work of this stage
  uint64_t total = 0;
};

// What was done so far; complete once `advance` said kDone.
struct BindingSummary {
  uint64_t rows = 0, entries = 0;
  uint64_t samples = 0, walk_steps = 0, walks_capped = 0, walks_discarded = 0, walk_reentries = 0;
  uint64_t rows_on_cage = 0, rows_outside = 0, rows_few_samples = 0, rows_no_samples = 0, rows_rank_deficient = 0,
           rows_above_target = 0;
  double linear_precision_error_max = 0.0;  // |sum a_v x_v - x| / max(1, |x|), normalized frame
  double solving_s = 0.0, sampling_s = 0.0, smoothing_factor_s = 0.0, smoothing_solve_s = 0.0, rows_s = 0.0;
  double smoothing_time = 0.0;    // the longest of any point; 0 without denoising
  std::vector<Warning> warnings;  // of the cage and of the query set
};

struct BindingSettings {
  ResolvedOptions options;
  uint32_t block_rows = 4096;      // 1 or more
  uint64_t first_row = 0;          // rows before it are not produced
  KernelCache* kernels = nullptr;  // borrowed; null: every denoising factors its own
};

inline const std::atomic<bool> kNeverCancelled = false;

class Binding {
 public:
  // Errors, with paths relative to the request: kInvalidArgument ("points[17]": non-finite,
  // "faces[3].corner[1]": no such point, no points at all), and those of check_estimator (cage_index.h).
  // kCancelled when `cancel` was seen set: reading millions of points takes a while.
  static Result<std::unique_ptr<Binding>> create(std::shared_ptr<const CageIndex> index, QueryInput queries,
                                                 const BindingSettings& settings,
                                                 const std::atomic<bool>& cancel = kNeverCancelled);
  virtual ~Binding() = default;

  enum class Step { kWorking, kBlock, kDone, kCancelled };
  // Does the next piece of work. kBlock: take_block() has the next rows. kCancelled: `cancel` was seen
  // set; the binding is of no further use. Notices `cancel` within about ten milliseconds, except
  // while it factorizes the smoothing matrix.
  virtual Step advance(const std::atomic<bool>& cancel) = 0;
  virtual RowBlock take_block() = 0;

  virtual Progress progress() const = 0;
  virtual const BindingSummary& summary() const = 0;
  // The longest smoothing time, in squared diagonals, that a point is or will be given; near the cage it may be less. 0
  // without denoising. Known from creation.
  virtual double smoothing_time() const = 0;

 protected:
  Binding() = default;
};

// All rows in one block, on the calling thread's arena.
Result<RowBlock> bind_all(std::shared_ptr<const CageIndex> index, QueryInput queries, const ResolvedOptions& options,
                          BindingSummary* summary = nullptr);

}  // namespace barycast
