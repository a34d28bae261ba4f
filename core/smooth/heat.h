#pragma once

// One implicit step of heat flow, (A T^-1 + L)^-1 A T^-1 with the nodes' times on the diagonal of T; with one time t
// for all, (A + t L)^-1 A [SBC 4.4]. Factor once, then solve for many columns, kColumns at a time. Rows sum to one, so
// smoothing every u_v by the same operator keeps linear precision. Nodes without area, and components much smaller than
// the kernel, are left alone. Factored in double, solved in floats, whose rounding is far below the noise, and which
// the last correction of every row takes out of linear precision; every column is solved in one fixed order, so threads
// that share the work cannot change a bit.

#include <Eigen/SparseCholesky>
#include <atomic>
#include <span>
#include <vector>

#include "base/result.h"
#include "smooth/laplacian.h"

namespace barycast {

class HeatKernel {
 public:
  // Columns of one solve: two cache lines per node, enough to hide the memory of the factor.
  static constexpr size_t kColumns = 32;

  // times: of every node, positive, or 0 for all. Errors: kResourceExhausted when the factor would be far denser than a
  // surface's (found before the work is done), kInternal when the matrix is not positive definite to rounding.
  static Result<HeatKernel> create(const MeshLaplacian& laplacian, std::span<const double> times);

  // Where a node stands in a block: those that take part first, in the order of elimination.
  size_t place(size_t node) const { return place_[node]; }
  // Whether a node takes part; what others hold in a block stays as it is.
  bool smooths(size_t node) const { return place_[node] < weight_.size(); }

  // Smooths a block (nodes x kColumns, every node at its place) in place. False: `cancel` was seen set, and the block
  // is in no defined state. Const, thread-safe.
  bool smooth(std::span<float> block, const std::atomic<bool>& cancel) const;

  size_t bytes() const;

 private:
  HeatKernel() = default;
  std::vector<uint32_t> place_;    // by node: its row of the factor, or beyond
  std::vector<float> weight_;      // by row: A t / t_i, t the longest time
  std::vector<int> column_begin_;  // of the unit lower triangular factor, below its diagonal
  std::vector<int> row_;
  std::vector<float> factor_;
  std::vector<float> inverse_pivot_;
};

}  // namespace barycast
