#include "solve/tiled_cholesky.h"

#include <Eigen/Cholesky>
#include <algorithm>

#include "base/parallel.h"

namespace barycast {
namespace {

// Of the largest diagonal entry: above the rounding of a thousand products, below the errors of quadrature.
constexpr double kFirstRaise = 1e-8;

// Products of tiles that a thread does at a time: 2 million operations each.
constexpr size_t kProducts = 100;

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

// Columns to the left come off first, always in the same order.
void TiledCholesky::factor() {
  const size_t j = column_, first = j + rows_updated_;
  const size_t rows = std::min(tiles_per_row_ - first, std::max<size_t>(1, kProducts / (j + 1)) * parallel_width());
  parallel_for(rows, 1, [&](size_t begin, size_t end) {
    for (size_t i = first + begin; i < first + end; ++i)
      for (size_t k = 0; k < j; ++k) tile(i, j).noalias() -= tile(i, k) * tile(j, k).transpose();
  });
  rows_updated_ += rows;
  if (j + rows_updated_ == tiles_per_row_) finish_column();
}

void TiledCholesky::finish_column() {
  const size_t j = column_++;
  rows_updated_ = 0;
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

void TiledCholesky::forward(size_t row, Columns& columns) const {
  auto rows = columns.middleRows(static_cast<Eigen::Index>(row) * kTile, kTile);
  for (size_t k = 0; k < row; ++k)
    rows.noalias() -= tile(row, k) * columns.middleRows(static_cast<Eigen::Index>(k) * kTile, kTile);
  tile(row, row).triangularView<Eigen::Lower>().solveInPlace(rows);
}

void TiledCholesky::backward(size_t row, Columns& columns) const {
  auto rows = columns.middleRows(static_cast<Eigen::Index>(row) * kTile, kTile);
  for (size_t k = row + 1; k < tiles_per_row_; ++k)
    rows.noalias() -= tile(k, row).transpose() * columns.middleRows(static_cast<Eigen::Index>(k) * kTile, kTile);
  tile(row, row).transpose().triangularView<Eigen::Upper>().solveInPlace(rows);
}

}  // namespace barycast
