#pragma once

// Cholesky factorization of a dense symmetric matrix in square tiles, piece by piece and in parallel, in an order
// that neither threads nor caches can change: bits are the same on every machine. n^3 / 3 multiplications;
// half of a matrix of memory.

#include <Eigen/Core>
#include <cstddef>
#include <vector>

namespace barycast {

class TiledCholesky {
 public:
  static constexpr Eigen::Index kTile = 96;
  using Columns = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  using Tile = Eigen::Map<Columns>;  // kTile x kTile

  // Room for n rows; rows beyond n, up to whole tiles, are the identity's.
  explicit TiledCholesky(size_t n);

  size_t tile_count() const { return tiles_per_row_; }  // along a row
  // Tile (i, j), j <= i: to be filled before the first step. The diagonal ones need their lower half only.
  Tile tile(size_t i, size_t j) { return Tile(elements_.data() + offset(i, j), kTile, kTile); }

  // The next piece of the factorization: a part of a column of tiles, about ten milliseconds on the calling arena.
  // Where the matrix is not positive definite its diagonal is raised.
  void factor();
  bool is_factored() const { return column_ == tiles_per_row_; }
  size_t columns_done() const { return column_; }
  size_t columns_raised() const { return columns_raised_; }

  // Solving in place for columns of right-hand sides, padded to whole tiles of rows: forward for every row of tiles
  // upwards, then backward for every row downwards. Columns do not affect each other.
  void forward(size_t row, Columns& columns) const;
  void backward(size_t row, Columns& columns) const;

  static size_t bytes(size_t n);

 private:
  void finish_column();
  static size_t offset(size_t i, size_t j) { return (i * (i + 1) / 2 + j) * kTile * kTile; }
  Eigen::Map<const Columns> tile(size_t i, size_t j) const {
    return Eigen::Map<const Columns>(elements_.data() + offset(i, j), kTile, kTile);
  }

  size_t tiles_per_row_;
  std::vector<double> elements_;
  size_t column_ = 0, rows_updated_ = 0;  // of the factorization
  size_t columns_raised_ = 0;
};

}  // namespace barycast
