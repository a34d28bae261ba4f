#pragma once

// From linear fits to the sparse row that leaves: evaluated at the query [SBC Eq. 10], pruned, and
// brought back to linear precision by one minimum-norm correction in double. Every row, whatever its
// path, ends here.

#include <vector>

#include "cage/cage.h"
#include "estimate/projection.h"

namespace barycast {

template <int D>
struct RowEntry {
  uint32_t vertex;
  double value;
  Vec<D> gradient;  // per diagonal of the cage
};

struct RowSettings {
  double prune_below = 1e-4;    // 0: nothing is dropped
  bool gradients = false;       // gradients leave too: they count for what is kept, and are corrected
  uint32_t influences_max = 0;  // most entries of a row, d + 1 or more; 0: no limit
};

// Evaluates and finishes rows. Const and thread-safe.
template <int D>
class RowFinisher {
 public:
  RowFinisher(const Cage<D>& cage, const RowSettings& settings);

  // All entries of the query at x that may survive pruning, ascending by vertex.
  void evaluate(const Projected<D>& projected, const Vec<D>& x, std::vector<RowEntry<D>>& row) const;

  // Prunes and corrects in place. A vertex is kept for its value or its gradient, the largest values first where
  // their number is limited; the kept ones span space with a bounded condition, by the next largest ones and,
  // where there are none, by explicit zeros. Returns what is left of |sum a_v x_v - x| / max(1, |x|).
  double finish(const Vec<D>& x, std::vector<RowEntry<D>>& row) const;

  // Whether an entry survives pruning by its size, with the threshold scaled.
  bool is_kept(double value, double gradient_norm, double threshold_scale = 1.0) const {
    return value >= threshold_scale * settings_.prune_below || value <= -threshold_scale * settings_.prune_below ||
           (settings_.gradients && gradient_norm >= threshold_scale * prune_gradient_below_);
  }
  bool gradients() const { return settings_.gradients; }

 private:
  void prune(std::vector<RowEntry<D>>& row) const;
  void limit(std::vector<RowEntry<D>>& row) const;
  double correct(const Vec<D>& x, std::vector<RowEntry<D>>& row) const;

  const Cage<D>& cage_;
  RowSettings settings_;
  double prune_gradient_below_;    // per diagonal
  std::vector<Vec<D>> whitened_;   // control vertices, in a frame where the used ones' covariance is the identity
  double reach_;                   // the largest |[x_v; 1]| of a used vertex
  std::vector<uint32_t> simplex_;  // used vertices far apart, d + 1 of them, ascending
};

extern template class RowFinisher<2>;
extern template class RowFinisher<3>;

}  // namespace barycast
