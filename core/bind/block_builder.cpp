#include "bind/block_builder.h"

namespace barycast {

void add_counts(const SampleCounts& counts, BindingSummary& summary) {
  summary.samples += counts.started;
  summary.walk_steps += counts.steps;
  summary.walks_capped += counts.capped;
  summary.walks_discarded += counts.discarded;
  summary.walk_reentries += counts.reentries;
}

template <int D>
RowBlock BlockBuilder<D>::pack(BindingSummary& summary) {
  RowBlock block;
  block.first_row = next_row_ - rows_.size();
  block.offsets.push_back(0);
  for (const FinishedRow<D>& row : rows_) {
    for (const RowEntry<D>& entry : row.entries) {
      block.indices.push_back(entry.vertex);
      block.values.push_back(entry.value);
      if (settings_.options.gradients)
        for (int k = 0; k < D; ++k) block.gradients.push_back(entry.gradient[k] / diagonal_);
    }
    block.offsets.push_back(static_cast<uint32_t>(block.indices.size()));
    block.flags.push_back(row.flags);
    add_counts(row.counts, summary);
    summary.linear_precision_error_max = std::max(summary.linear_precision_error_max, row.error);
    summary.rows_on_cage += (row.flags & kRowOnCage) != 0;
    summary.rows_outside += (row.flags & kRowOutside) != 0;
    summary.rows_few_samples += (row.flags & kRowFewSamples) != 0;
    summary.rows_no_samples += (row.flags & kRowNoSamples) != 0;
    summary.rows_rank_deficient += (row.flags & kRowRankDeficient) != 0;
  }
  summary.rows += rows_.size();
  summary.entries += block.indices.size();
  rows_.clear();
  return block;
}

template class BlockBuilder<2>;
template class BlockBuilder<3>;

}  // namespace barycast
