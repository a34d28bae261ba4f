#pragma once

// Rows made piece by piece, packed into blocks and counted: what every binding ends in.

#include <algorithm>
#include <atomic>
#include <span>
#include <vector>

#include "bind/binding.h"
#include "bind/quantum.h"
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
};

void add_counts(const SampleCounts& counts, BindingSummary& summary);

// The rows under way to the next block.
template <int D>
class BlockBuilder {
 public:
  // `diagonal`: of the cage, the unit of the rows' gradients.
  BlockBuilder(const BindingSettings& settings, double diagonal) : settings_(settings), diagonal_(diagonal) {}

  // The next rows of `points` in all, as many as fill the quantum: body(first_row, rows) fills some in place, in
  // parallel, and says whether to go on. With kBlock they are in `block`, and counted in `summary`.
  template <class Body>
  Binding::Step advance(size_t points, Quantum& quantum, size_t grain, const std::atomic<bool>& cancel,
                        const Body& body, RowBlock& block, BindingSummary& summary) {
    if (next_row_ == points && rows_.empty()) return Binding::Step::kDone;
    const size_t room = settings_.block_rows - rows_.size(), first = rows_.size();
    const size_t count = std::min({quantum.size(), room, points - next_row_});
    rows_.resize(first + count);
    const bool complete = quantum.run(count, grain, cancel, [&](size_t begin, size_t end) {
      return body(next_row_ + begin, std::span(rows_).subspan(first + begin, end - begin));
    });
    if (!complete) return Binding::Step::kCancelled;
    next_row_ += count;
    if (count < room && next_row_ < points) return Binding::Step::kWorking;
    block = pack(summary);
    return Binding::Step::kBlock;
  }

  uint64_t next_row() const { return next_row_; }

 private:
  RowBlock pack(BindingSummary& summary);

  const BindingSettings& settings_;
  const double diagonal_;
  uint64_t next_row_ = settings_.first_row;
  std::vector<FinishedRow<D>> rows_;  // the last ones before next_row_
};

extern template class BlockBuilder<2>;
extern template class BlockBuilder<3>;

}  // namespace barycast
