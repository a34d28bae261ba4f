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
void BlockBuilder<D>::pack(size_t count, BindingSummary& summary) {
  if (block_.flags.empty()) {
    block_.first_row = next_row_;
    block_.offsets.push_back(0);
  }
  const size_t before = block_.indices.size();
  for (FinishedRow<D>& row : std::span(rows_).first(count)) {
    for (const RowEntry<D>& entry : row.entries) {
      block_.indices.push_back(entry.vertex);
      block_.values.push_back(entry.value);
      if (settings_.options.gradients)
        for (int k = 0; k < D; ++k) block_.gradients.push_back(entry.gradient[k] / diagonal_);
    }
    block_.offsets.push_back(static_cast<uint32_t>(block_.indices.size()));
    block_.flags.push_back(row.flags);
    if (const double target = settings_.options.target_error; target > 0.0) {
      block_.errors.push_back(static_cast<float>(row.noise.standard));
      block_.errors.push_back(static_cast<float>(row.noise.at_95));
      summary.rows_above_target += row.noise.standard > target;
    }
    add_counts(row.counts, summary);
    summary.linear_precision_error_max = std::max(summary.linear_precision_error_max, row.error);
    summary.rows_on_cage += (row.flags & kRowOnCage) != 0;
    summary.rows_outside += (row.flags & kRowOutside) != 0;
    summary.rows_few_samples += (row.flags & kRowFewSamples) != 0;
    summary.rows_no_samples += (row.flags & kRowNoSamples) != 0;
    summary.rows_rank_deficient += (row.flags & kRowRankDeficient) != 0;
    row.clear();
  }
  next_row_ += count;
  summary.rows += count;
  summary.entries += block_.indices.size() - before;
}

template class BlockBuilder<2>;
template class BlockBuilder<3>;

}  // namespace barycast
