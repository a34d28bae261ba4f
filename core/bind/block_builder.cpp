#include "bind/block_builder.h"

#include <bit>

namespace barycast {
namespace {

// Room for some more at the end. Grows by doubling, as bind/cost.cpp counts on.
template <class T>
T* extend(std::vector<T>& list, size_t count) {
  const size_t before = list.size(), after = before + count;
  if (after > list.capacity()) list.reserve(std::bit_ceil(after));
  list.resize(after);
  return list.data() + before;
}

}  // namespace

void add_counts(const SampleCounts& counts, BindingSummary& summary) {
  summary.samples += counts.started;
  summary.walk_steps += counts.steps;
  summary.walks_capped += counts.capped;
  summary.walks_discarded += counts.discarded;
  summary.walk_reentries += counts.reentries;
}

template <int D>
void BlockBuilder<D>::pack(size_t count, uint64_t rows_left, BindingSummary& summary) {
  if (block_.flags.empty()) {
    block_.first_row = next_row_;
    block_.offsets.push_back(0);
    // As much as the last whole block took: to grow into it would write everything twice, on one thread.
    if (rows_left >= settings_.block_rows) {
      block_.indices.reserve(entries_held_);
      block_.values.reserve(entries_held_);
      block_.gradients.reserve(gradients_held_);
    }
  }
  const size_t before = block_.indices.size();
  for (FinishedRow<D>& row : std::span(rows_).first(count)) {
    append(row.entries);
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
  entries_held_ = block_.indices.capacity();
  gradients_held_ = block_.gradients.capacity();
  next_row_ += count;
  summary.rows += count;
  summary.entries += block_.indices.size() - before;
}

template <int D>
void BlockBuilder<D>::append(const std::vector<RowEntry<D>>& entries) {
  uint32_t* index = extend(block_.indices, entries.size());
  double* value = extend(block_.values, entries.size());
  for (const RowEntry<D>& entry : entries) {
    *index++ = entry.vertex;
    *value++ = entry.value;
  }
  if (!settings_.options.gradients) return;
  double* gradient = extend(block_.gradients, D * entries.size());
  for (const RowEntry<D>& entry : entries)
    for (int k = 0; k < D; ++k) *gradient++ = entry.gradient[k] / diagonal_;
}

template class BlockBuilder<2>;
template class BlockBuilder<3>;

}  // namespace barycast
