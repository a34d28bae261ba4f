#pragma once

// Rows of sums over panels, compared.

#include "solve/panel_sums.h"

namespace barycast::testing {

// Whether `some` are the rows of `all` from `first` on, bit for bit; gradients as far as `some` have them.
inline bool same(const PanelSums::Rows& all, size_t first, const PanelSums::Rows& some) {
  const auto begin = static_cast<Eigen::Index>(first);
  bool result = all.values.middleRows(begin, some.values.rows()) == some.values;
  for (size_t k = 0; k < 3 && some.gradients[k].size() > 0; ++k)
    result &= all.gradients[k].middleRows(begin, some.gradients[k].rows()) == some.gradients[k];
  for (size_t i = 0; i < some.enclosed.size(); ++i) result &= all.enclosed[first + i] == some.enclosed[i];
  return result;
}

}  // namespace barycast::testing
