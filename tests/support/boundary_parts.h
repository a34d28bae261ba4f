#pragma once

// What boundary elements solve for, all of it at once.

#include <gtest/gtest.h>

#include "solve/boundary_elements.h"

namespace barycast::testing {

inline BoundaryParts solved(const Cage<3>& cage, BoundarySides side, uint32_t panels) {
  auto solver = BoundarySolver::create(cage, {.panels = panels, .sides = side});
  EXPECT_TRUE(solver.ok());
  while ((*solver)->done() < (*solver)->total()) (*solver)->advance();
  return (*solver)->take_parts();
}

}  // namespace barycast::testing
