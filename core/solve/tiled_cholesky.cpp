#include "solve/tiled_cholesky.h"

#include <Eigen/Cholesky>
#include <cmath>

#include "base/parallel.h"

namespace barycast {
namespace {

// Of the largest diagonal entry: above the rounding of a thousand products, below the errors of quadrature.
constexpr double kFirstRaise = 1e-8;

size_t tiles_for(size_t n) {
  return (n + TiledCholesky::kTile - 1) / TiledCholesky::kTile;
}

}  // namespace

TiledCholesky::TiledCholesky(size_t n) : tiles_per_row_(tiles_for(n)) {
  elements_.resize(offset(tiles_per_row_, 0));
}

size_t TiledCholesky::bytes(size_t n) {
  return offset(tiles_for(n), 0) * sizeof(double);
}

void TiledCholesky::factor_column() {
  const size_t j = columns_done_++;
  // Columns to the left first, always in the same order.
  parallel_for(tiles_per_row_ - j, 1, [&](size_t begin, size_t end) {
    for (size_t i = j + begin; i < j + end; ++i)
      for (size_t k = 0; k < j; ++k) tile(i, j).noalias() -= tile(i, k) * tile(j, k).transpose();
  });
  Tile diagonal = tile(j, j);
  const Columns before = diagonal;
  for (double raise = kFirstRaise; Eigen::LLT<Eigen::Ref<Columns>>(diagonal).info() != Eigen::Success; raise *= 10) {
    if (raise == kFirstRaise) ++columns_raised_;
    diagonal = before;
    diagonal.diagonal().array() += raise * before.diagonal().cwiseAbs().maxCoeff();
  }
  parallel_for(tiles_per_row_ - j - 1, 1, [&](size_t begin, size_t end) {
    for (size_t i = j + 1 + begin; i < j + 1 + end; ++i) {
      Tile below = tile(i, j);
      diagonal.transpose().triangularView<Eigen::Upper>().solveInPlace<Eigen::OnTheRight>(below);
    }
  });
}

void TiledCholesky::solve(Eigen::Ref<Columns, 0, Eigen::OuterStride<>> columns) const {
  const auto part = [&](size_t i) { return columns.middleRows(static_cast<Eigen::Index>(i) * kTile, kTile); };
  for (size_t i = 0; i < tiles_per_row_; ++i) {
    for (size_t k = 0; k < i; ++k) part(i).noalias() -= tile(i, k) * part(k);
    auto rows = part(i);
    tile(i, i).triangularView<Eigen::Lower>().solveInPlace(rows);
  }
  for (size_t i = tiles_per_row_; i-- > 0;) {
    for (size_t k = i + 1; k < tiles_per_row_; ++k) part(i).noalias() -= tile(k, i).transpose() * part(k);
    auto rows = part(i);
    tile(i, i).transpose().triangularView<Eigen::Upper>().solveInPlace(rows);
  }
}

}  // namespace barycast
