#pragma once

// Corrections of a prediction without walks of a point's own: inside a closed cage a correction is a harmonic function
// of the point, so that walks from the sphere of a ball find it for the whole ball, as coefficients of solid harmonics.
// A cover of the cage by such balls (estimate/ball_cover.h) serves all points that are not close to the cage.
//
// Tables depend on the cage alone, not on the points, the request or its seed: which are there already, and whether one
// could be kept, changes no bit. They are built where points first ask for them, in some tenths of a millisecond
// each, or ahead. A point then takes a few tenths of a microsecond. Corrections are continuous in the point, to the
// second derivative's jumps. Safe from any number of threads.

#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "estimate/ball_cover.h"
#include "estimate/missing_at_ends.h"
#include "estimate/solid_harmonics.h"
#include "sample/walks.h"
#include "solve/prediction.h"

namespace barycast {

struct BallTableSettings {
  uint32_t walks = 256;  // from every ball
  // Of tables that are kept; others are computed and dropped, with the same bits.
  size_t bytes_max = size_t{64} << 20;
};

class BallTables {
 public:
  // Of a closed cage; `inside` is its prediction there. All must outlive the tables.
  BallTables(const Cage<3>& cage, const DistanceIndex<3>& distance, const WindingNumber<3>& winding,
             const HarmonicPrediction& inside, const BallTableSettings& settings = {});

  size_t columns() const { return columns_; }

  // Where own walks have faded out.
  static constexpr double kOwnWalksEnd = 1.5 * BallCover::kDistanceMin;
  // The tables' part of a correction at a distance from the cage, the rest being the point's own walks': smooth, 0
  // where the cover ends, 1 from half as far again on.
  static double part(double distance);

  struct Workspace {
    struct Use {
      const BallLeaf* leaf;
      size_t point;
      float weight;
    };
    std::vector<Use> uses;
    std::vector<const BallLeaf*> wanted;  // without a table
    std::vector<BallTable> tables;        // of those that are wanted, where they could not be kept
    std::vector<SampleQuery<3>> queries;
    std::vector<SampleSet<3>> samples;
    MissingAtEnds at_ends;
    std::vector<float> row, coefficients;
  };

  // Corrections of points inside of the cage with a part() above 0, a row of columns() each; with gradients four times
  // that, values and their partial derivatives per diagonal. Those are the mean of the balls' own, without that of the
  // weights: balls differ by noise. False: `cancel` was seen set.
  bool correct(std::span<const Vec<3>> points, bool gradients, const std::atomic<bool>& cancel, Workspace& workspace,
               std::span<float> corrections) const;

  // Builds tables ahead, on the threads of the calling arena, until all are there, `tables_max` have been built, the
  // bound on bytes is met, or `cancel` is set. Returns how many it built.
  size_t build(size_t tables_max, const std::atomic<bool>& cancel) const {
    return build(missing(tables_max, cancel), cancel);
  }
  // The same in pieces: leaves that have no table, the largest cells first, no more than may be kept; and their tables.
  // To find a hundred thousand of them takes half a second where no point has asked for their cells.
  std::vector<const BallLeaf*> missing(size_t tables_max, const std::atomic<bool>& cancel) const;
  size_t build(std::span<const BallLeaf* const> leaves, const std::atomic<bool>& cancel) const;

  size_t table_count() const { return tables_.load(std::memory_order_relaxed); }
  // Held now.
  size_t bytes() const { return sizeof(*this) + cover_.bytes() + table_bytes_.load(std::memory_order_relaxed); }
  const BallCover& cover() const { return cover_; }

 private:
  size_t width() const { return (columns_ + kLanes - 1) / kLanes * kLanes; }
  static constexpr size_t kLanes = 16;
  size_t table_bytes_each() const { return sizeof(BallTable) + kHarmonics * width() * sizeof(int16_t); }

  bool make(std::span<const BallLeaf* const> leaves, const std::atomic<bool>& cancel, Workspace& workspace) const;
  // False: `cancel` was seen set.
  bool fill(const SampleQuery<3>& query, const SampleSet<3>& samples, const std::atomic<bool>& cancel,
            Workspace& workspace, BallTable& table) const;
  void keep(const BallLeaf& leaf, BallTable& table) const;

  const HarmonicPrediction& inside_;
  BallCover cover_;
  HarmonicWalks<3> walks_;
  BallTableSettings settings_;
  size_t columns_;
  mutable std::atomic<size_t> tables_ = 0, table_bytes_ = 0;
};

}  // namespace barycast
