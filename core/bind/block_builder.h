#pragma once

// Rows made piece by piece, packed into blocks and counted: what every binding ends in.

#include <algorithm>
#include <atomic>
#include <span>
#include <utility>
#include <vector>

#include "base/parallel.h"
#include "bind/binding.h"
#include "bind/quantum.h"
#include "estimate/error_estimate.h"
#include "estimate/row.h"
#include "sample/sample.h"

namespace barycast {

// A row and what it says about itself, before it is packed.
template <int D>
struct FinishedRow {
  std::vector<RowEntry<D>> entries;
  double error = 0.0;  // of linear precision
  uint8_t flags = 0;
  SampleCounts counts;
  Randomizations::Error noise{};  // with a target error

  // Keeps its memory.
  void clear() {
    entries.clear();
    error = 0.0;
    flags = 0;
    counts = {};
    noise = {};
  }
};

void add_counts(const SampleCounts& counts, BindingSummary& summary);

// The block under way, and the rows that will be packed next.
template <int D>
class BlockBuilder {
 public:
  // Rows are made at most so many at a time for every thread, unpacked: more would leave the caches.
  static constexpr size_t kRowsPerThread = 64;

  // `diagonal`: of the cage, the unit of the rows' gradients.
  BlockBuilder(const BindingSettings& settings, double diagonal, size_t rows_per_thread = kRowsPerThread)
      : settings_(settings), diagonal_(diagonal), rows_per_thread_(rows_per_thread) {}

  // The next rows of `points` in all, as many as fill the quantum: body(first_row, rows) fills some in place, in
  // parallel, and says whether to go on. With kBlock they are in `block`, and counted in `summary`.
  template <class Body>
  Binding::Step advance(size_t points, Quantum& quantum, size_t grain, const std::atomic<bool>& cancel,
                        const Body& body, RowBlock& block, BindingSummary& summary) {
    if (next_row_ == points && block_.flags.empty()) return Binding::Step::kDone;
    const size_t room = settings_.block_rows - block_.flags.size();
    const size_t count = std::min({quantum.size(), room, points - next_row_});
    const size_t batch = rows_per_thread_ * parallel_width();
    if (rows_.size() < std::min(batch, count)) rows_.resize(std::min(batch, count));
    const uint64_t first_row = next_row_;
    const bool complete = quantum.run(
        count, batch, grain, cancel,
        [&](size_t begin, size_t end) {
          return body(first_row + begin, std::span(rows_).subspan(begin % batch, end - begin));
        },
        [&](size_t begin, size_t end) { pack(end - begin, points - next_row_, summary); });
    if (!complete) return Binding::Step::kCancelled;
    if (count < room && next_row_ < points) return Binding::Step::kWorking;
    block = std::exchange(block_, {});
    return Binding::Step::kBlock;
  }

  uint64_t next_row() const { return next_row_; }

 private:
  // Appends the first of rows_, which are from next_row_ on, to the block, and clears them. rows_left: to the end of
  // all, with them.
  void pack(size_t count, uint64_t rows_left, BindingSummary& summary);
  void append(const std::vector<RowEntry<D>>& entries);

  const BindingSettings& settings_;
  const double diagonal_;
  const size_t rows_per_thread_;
  uint64_t next_row_ = settings_.first_row;
  RowBlock block_;
  size_t entries_held_ = 0, gradients_held_ = 0;  // what the block, or the last one, has room for
  std::vector<FinishedRow<D>> rows_;
};

extern template class BlockBuilder<2>;
extern template class BlockBuilder<3>;

}  // namespace barycast
