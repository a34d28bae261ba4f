#include "smooth/heat.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace barycast {
namespace {

constexpr size_t kCheckEvery = 2048;  // rows between two looks at `cancel`, well below a millisecond

// Multiplications of a factorization that cannot be interrupted: some seconds. Twelve
// thousand points that faces connect at random exceed it; no surface of the tests comes near.
constexpr double kFactorOperationsMax = 5e10;
// A component of the mesh with less area than this times its longest smoothing time is far smaller than the
// kernel's reach; its matrix is singular to rounding. Its nodes keep their rows.
constexpr double kComponentAreaMin = 1e-9;

using Sparse = Eigen::SparseMatrix<double>;

// Nodes with area, in components large enough.
std::vector<bool> nodes_to_smooth(const MeshLaplacian& laplacian, std::span<const double> times) {
  const auto count = static_cast<size_t>(laplacian.area.size());
  std::vector<uint32_t> parent(count);
  std::iota(parent.begin(), parent.end(), 0u);
  const auto root = [&](uint32_t node) {
    while (parent[node] != node) node = parent[node] = parent[parent[node]];
    return node;
  };
  for (int column = 0; column < laplacian.stiffness.outerSize(); ++column)
    for (Sparse::InnerIterator it(laplacian.stiffness, column); it; ++it)
      parent[root(static_cast<uint32_t>(it.row()))] = root(static_cast<uint32_t>(column));
  std::vector<double> area(count, 0.0), time(count, 0.0);
  for (uint32_t i = 0; i < count; ++i) {
    area[root(i)] += laplacian.area[i];
    time[root(i)] = std::max(time[root(i)], times[i]);
  }
  std::vector<bool> result(count);
  for (uint32_t i = 0; i < count; ++i)
    result[i] = laplacian.area[i] > 0.0 && area[root(i)] > kComponentAreaMin * time[root(i)];
  return result;
}

// Operations of the factorization in this order, by walking the elimination tree [Davis 2005, LDL] of the upper
// triangle; stops counting beyond the bound.
double factor_operations(const Sparse& upper) {
  const auto size = static_cast<size_t>(upper.rows());
  std::vector<int> parent(size, -1), seen(size, -1);
  std::vector<double> below(size, 0.0);
  double operations = 0.0;
  for (int k = 0; k < upper.cols() && operations <= kFactorOperationsMax; ++k) {
    seen[static_cast<size_t>(k)] = k;
    for (Sparse::InnerIterator it(upper, k); it; ++it) {
      if (it.row() >= k) continue;  // in no particular order
      for (auto i = static_cast<size_t>(it.row()); seen[i] != k; i = static_cast<size_t>(parent[i])) {
        if (parent[i] < 0) parent[i] = k;
        seen[i] = k;
        operations += 2 * below[i]++ + 1;  // the sum of squares of the columns' lengths
      }
    }
  }
  return operations;
}

}  // namespace

Result<HeatKernel> HeatKernel::create(const MeshLaplacian& laplacian, std::span<const double> times) {
  const double time = times.empty() ? 0.0 : *std::max_element(times.begin(), times.end());
  const auto weight = [&](uint32_t node) { return laplacian.area[node] * (time > 0.0 ? time / times[node] : 1.0); };
  const std::vector<bool> active_node = nodes_to_smooth(laplacian, times);
  std::vector<int> row_of(active_node.size(), -1);
  std::vector<uint32_t> active;
  for (size_t i = 0; i < active_node.size(); ++i) {
    if (!active_node[i]) continue;
    row_of[i] = static_cast<int>(active.size());
    active.push_back(static_cast<uint32_t>(i));
  }
  // Active nodes were renumbered in order, so the lower triangle stays the lower triangle, and its columns sorted.
  const auto size = static_cast<Eigen::Index>(active.size());
  Sparse matrix(size, size);
  matrix.reserve(laplacian.stiffness.nonZeros() + size);
  for (const uint32_t node : active) {
    const int column = row_of[node];
    matrix.startVec(column);
    const auto in_mesh = static_cast<int>(node);
    matrix.insertBack(column, column) = weight(node) + time * laplacian.stiffness.coeff(in_mesh, in_mesh);
    for (Sparse::InnerIterator it(laplacian.stiffness, in_mesh); it; ++it)
      if (it.row() != in_mesh) matrix.insertBack(row_of[static_cast<size_t>(it.row())], column) = time * it.value();
  }
  matrix.finalize();
  // In the order that keeps the factor sparse.
  Eigen::AMDOrdering<int>::PermutationType inverse;
  Eigen::AMDOrdering<int>()(matrix.selfadjointView<Eigen::Lower>(), inverse);
  const Eigen::AMDOrdering<int>::PermutationType order = inverse.inverse();
  Sparse upper(size, size);
  upper.selfadjointView<Eigen::Upper>() = matrix.selfadjointView<Eigen::Lower>().twistedBy(order);
  if (factor_operations(upper) > kFactorOperationsMax)
    return Error{
        ErrorCode::kResourceExhausted, "faces",
        "the faces connect the points in no surface-like way, so denoising would take too long and was left out"};
  const Eigen::SimplicialLDLT<Sparse, Eigen::Upper, Eigen::NaturalOrdering<int>> ldlt(upper);
  const Eigen::VectorXd pivots = ldlt.vectorD();  // a copy every time it is asked for
  if (ldlt.info() != Eigen::Success || (size > 0 && !(pivots.minCoeff() > 0.0)))
    return Error{ErrorCode::kInternal, "faces", "the smoothing matrix is not positive definite; ask for no denoising"};

  HeatKernel kernel;
  const Sparse& lower = ldlt.matrixL().nestedExpression();
  kernel.place_.resize(active_node.size());
  kernel.weight_.resize(active.size());
  for (uint32_t node = 0, beyond = static_cast<uint32_t>(active.size()); node < active_node.size(); ++node) {
    if (!active_node[node]) {
      kernel.place_[node] = beyond++;
      continue;
    }
    const auto row = static_cast<size_t>(order.indices()[row_of[node]]);
    kernel.place_[node] = static_cast<uint32_t>(row);
    kernel.weight_[row] = static_cast<float>(weight(node));
  }
  kernel.column_begin_.assign(lower.outerIndexPtr(), lower.outerIndexPtr() + size + 1);
  kernel.row_.assign(lower.innerIndexPtr(), lower.innerIndexPtr() + kernel.column_begin_.back());
  kernel.factor_.resize(kernel.row_.size());
  for (size_t i = 0; i < kernel.factor_.size(); ++i) kernel.factor_[i] = static_cast<float>(lower.valuePtr()[i]);
  kernel.inverse_pivot_.reserve(static_cast<size_t>(size));
  for (Eigen::Index i = 0; i < size; ++i) kernel.inverse_pivot_.push_back(static_cast<float>(1.0 / pivots[i]));
  return kernel;
}

bool HeatKernel::smooth(std::span<float> block, const std::atomic<bool>& cancel) const {
  const size_t count = weight_.size();
  float* const x = block.data();
  for (size_t i = 0; i < count; ++i)
    for (size_t k = 0; k < kColumns; ++k) x[i * kColumns + k] *= weight_[i];

  for (size_t j = 0; j < count; ++j) {  // L y = A b, column by column
    if (j % kCheckEvery == 0 && cancel.load(std::memory_order_relaxed)) return false;
    float pivot[kColumns];
    for (size_t k = 0; k < kColumns; ++k) pivot[k] = x[j * kColumns + k];
    for (int e = column_begin_[j]; e < column_begin_[j + 1]; ++e) {
      float* const target = x + static_cast<size_t>(row_[static_cast<size_t>(e)]) * kColumns;
      const float l = factor_[static_cast<size_t>(e)];
      for (size_t k = 0; k < kColumns; ++k) target[k] -= l * pivot[k];
    }
  }
  for (size_t j = count; j-- > 0;) {  // L^T x = D^-1 y
    if (j % kCheckEvery == 0 && cancel.load(std::memory_order_relaxed)) return false;
    float sum[kColumns];
    for (size_t k = 0; k < kColumns; ++k) sum[k] = inverse_pivot_[j] * x[j * kColumns + k];
    for (int e = column_begin_[j]; e < column_begin_[j + 1]; ++e) {
      const float* const source = x + static_cast<size_t>(row_[static_cast<size_t>(e)]) * kColumns;
      const float l = factor_[static_cast<size_t>(e)];
      for (size_t k = 0; k < kColumns; ++k) sum[k] -= l * source[k];
    }
    for (size_t k = 0; k < kColumns; ++k) x[j * kColumns + k] = sum[k];
  }
  return true;
}

size_t HeatKernel::bytes() const {
  return factor_.size() * (sizeof(float) + sizeof(int)) + place_.size() * sizeof(uint32_t) +
         weight_.size() * (sizeof(int) + 2 * sizeof(float));
}

}  // namespace barycast
