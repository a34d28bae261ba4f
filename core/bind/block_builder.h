#pragma once

// Finished rows, packed into blocks and counted: what every binding ends in.

#include <vector>

#include "bind/binding.h"
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

  size_t size() const { return rows_.size(); }
  size_t room() const { return settings_.block_rows - rows_.size(); }
  // Room for the next `count` rows, to be filled in place, in parallel.
  std::span<FinishedRow<D>> append(size_t count);

  // The rows so far; the first of them is `first_row`. Counts them in `summary`.
  RowBlock pack(uint64_t first_row, BindingSummary& summary);

 private:
  const BindingSettings& settings_;
  const double diagonal_;
  std::vector<FinishedRow<D>> rows_;
};

extern template class BlockBuilder<2>;
extern template class BlockBuilder<3>;

}  // namespace barycast
