#pragma once

// Harmonic coordinates by prediction and correction: a boundary-element solution h of the cage predicts them, and walks
// from the query find the mean of what it misses where they end (solve/prediction.h). Unbiased whatever the error of h,
// but for the walks' own: what they miss by ending within the thickness is a part of the correction, not of the
// coordinates.
//
// Inside a closed cage h are the coordinates. Elsewhere moments are predicted and corrected, and both are projected
// (estimate/moment_correction.h): the correction is what that changes. Where it is mostly noise, as in thin cages and
// narrow gaps, whose moments are nearly singular, the walks' own coordinates stand in.
//
// Gradients are the prediction's. Inside a closed cage that of the correction (estimate/first_steps.h) is added, as far
// as it stands out from its noise: few walks leave it away nearly everywhere, many find it. Near the cage, where it is
// steep and walks are short, it has more walks of its own, but to a target error or with tables, which have it where
// they serve.
//
// With tables (estimate/ball_tables.h) corrections inside a closed cage come from those, but close to the cage, where
// points walk themselves; in between, from both, by a share that is smooth in the distance.

#include <algorithm>
#include <array>
#include <atomic>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "estimate/ball_tables.h"
#include "estimate/error_estimate.h"
#include "estimate/first_steps.h"
#include "estimate/locator.h"
#include "estimate/missing_at_ends.h"
#include "estimate/moment_correction.h"
#include "estimate/projection.h"
#include "sample/walks.h"
#include "solve/prediction.h"

namespace barycast {

struct CorrectedPoint : Located<3> {
  Vec<3> origin;   // where prediction and correction are taken: the point, or off the cage beside it
  bool elsewhere;  // by moments
  SampleCounts counts;
};

// Whether samples of a point of a closed cage start outside of it. On the cage they do so where the place beside it is,
// which may be beyond the opposite wall.
bool starts_outside(const Located<3>& place, const Vec<3>& origin, const WindingNumber<3>& winding);

class CorrectedEstimator {
 public:
  struct Settings {
    double thickness;
    uint64_t seed;
    bool gradients;  // corrections have them
    bool closed;     // the cage bounds a volume
  };
  // Predictions may be null where no point needs them: those of closed cages whose samples start inside, and all
  // others. Without tables all points walk.
  CorrectedEstimator(const Cage<3>& cage, const DistanceIndex<3>& distance, const WindingNumber<3>& winding,
                     const HarmonicWalks<3>& walks, const HarmonicPrediction* inside,
                     const HarmonicPrediction* elsewhere, const BallTables* tables, const Settings& settings);

  // That a gradient near the cage takes, but to a target error or with tables.
  static constexpr uint32_t kSteepWalksMost = 260;

  // Columns of corrections and predictions: the control vertices that elements use, in their order.
  size_t columns() const { return cage_.used_vertices().size(); }
  // Of a correction: columns() values, and, if the settings say so, its partial derivatives, one after the other.
  size_t row_size() const { return settings_.gradients ? 4 * columns() : columns(); }

  struct Workspace {
    std::vector<double> clearances;
    std::vector<SampleQuery<3>> queries;
    std::vector<SampleQuery<3>> walking;  // those of the queries that walk themselves
    std::vector<size_t> walkers;
    std::vector<SampleSet<3>> samples;
    BallTables::Workspace tables;
    std::vector<float> from_tables;
    std::vector<size_t> chosen;  // places of one side, or with tables
    std::vector<Vec<3>> points;
    MissingAtEnds at_ends;
    std::vector<double> missing;
    std::vector<Vec<3>> directions;
    FirstSteps first_steps;
    std::vector<float> steep;   // a row of walks for gradients
    std::vector<double> noise;  // of the corrections' gradients, by point: their squared length's mean
    HarmonicPrediction::Rows rows;
    std::vector<float> found;                // by walks and tables, a row of found_size() each
    std::vector<BoundaryData::Row> moments;  // predicted: of points elsewhere
    std::optional<MomentAccumulator<3>> accumulator;
    Moments<3> own_moments;
    Projected<3> projected;
    Randomizations by_walk;
    // Points that are still off, and their places in what was asked for.
    std::vector<Vec<3>> open_points;
    std::vector<size_t> open;
    std::vector<CorrectedPoint> open_places;
    std::vector<Randomizations> randomizations;  // of all points: of values, elsewhere of missing moments
    std::vector<double> summed_noise;            // the same
  };

  // Where some points are (normalized frame), and their corrections, a row of row_size() each. Each is a function of
  // its position, the seed and the settings alone; with tables, of its position alone where it does not walk. False:
  // `cancel` was seen set. Const and thread-safe, a workspace per thread.
  bool correct(std::span<const Vec<3>> points, const std::atomic<bool>& cancel, Workspace& workspace,
               std::span<CorrectedPoint> places, std::span<float> corrections) const;

  // The same from as many independent randomizations as bring the standard error of a point down to `target`, looked at
  // after kRoundsLeast of them and every time that they have doubled, to kRoundsMost: corrections are those of all
  // their walks together, and `errors` says how far those are from what infinitely many would give.
  static constexpr size_t kRoundsLeast = 8, kRoundsMost = 512;
  bool correct_to(double target, std::span<const Vec<3>> points, const std::atomic<bool>& cancel, Workspace& workspace,
                  std::span<CorrectedPoint> places, std::span<float> corrections,
                  std::span<Randomizations::Error> errors) const;

  // A row of columns() values, and of their gradients per diagonal.
  struct Rows {
    BoundaryData::Row values;
    std::array<BoundaryData::Row, 3> gradients;  // of a point on the cage, or if the settings say so; else empty
  };
  // Predictions with their corrections: calls row(i, rows) for every point, in no particular order. On the cage, with
  // the prediction's gradient g where samples start, phi_v(y) + g_v . (x - y) [SBC 4.5], which is exact there. Const
  // and thread-safe, a workspace per thread. Elsewhere than inside no more than so many are predicted together.
  // False: `cancel` was seen set.
  static constexpr size_t kElsewhereTogether = 64;
  bool evaluate(std::span<const Vec<3>> points, std::span<const CorrectedPoint> places,
                std::span<const float> corrections, const std::atomic<bool>& cancel, Workspace& workspace,
                const std::function<void(size_t, const Rows&)>& row) const;

 private:
  // What one randomization finds: inside a correction, gradients as they come, with their noise; elsewhere what is
  // missing in the moments.
  bool find(std::span<const Vec<3>> points, uint64_t seed, const std::atomic<bool>& cancel, Workspace& workspace,
            std::span<CorrectedPoint> places) const;
  size_t found_size() const {
    return elsewhere_ == nullptr ? row_size() : std::max(row_size(), static_cast<size_t>(elsewhere_->columns()));
  }
  std::span<float> found(Workspace& workspace, size_t i) const {
    return std::span(workspace.found).subspan(i * found_size(), found_size());
  }
  bool find_moments(const SampleSet<3>& samples, size_t walks, const std::atomic<bool>& cancel, Workspace& workspace,
                    std::span<float> missing) const;
  // Near the cage: gradients of corrections, and their noise, from walks that are taken for them.
  bool find_steep_gradients(const std::atomic<bool>& cancel, Workspace& workspace,
                            std::span<CorrectedPoint> places) const;
  // What walks from a point inside found. Returns the noise of its gradient; nothing: `cancel` was seen set.
  std::optional<double> correct_inside(const CorrectedPoint& place, const SampleQuery<3>& query,
                                       const SampleSet<3>& samples, const std::atomic<bool>& cancel,
                                       Workspace& workspace, std::span<float> correction) const;
  // Of row i of corrections; and its partial derivatives, or nothing.
  std::span<float> row(std::span<float> corrections, size_t i) const {
    return corrections.subspan(i * row_size(), row_size());
  }
  std::span<float> gradient(std::span<float> row) const { return row.subspan(columns(), row_size() - columns()); }
  const HarmonicPrediction& prediction(bool elsewhere) const { return elsewhere ? *elsewhere_ : *inside_; }
  double tables_part(const CorrectedPoint& place, double distance) const {
    return tables_ == nullptr || place.elsewhere ? 0.0 : BallTables::part(distance);
  }
  bool walk(std::span<CorrectedPoint> places, const std::atomic<bool>& cancel, Workspace& workspace) const;
  bool blend_tables(std::span<const CorrectedPoint> places, const std::atomic<bool>& cancel,
                    Workspace& workspace) const;
  // Evaluates a prediction at the origins of the chosen places, all on one side.
  bool predict(std::span<const CorrectedPoint> places, bool elsewhere, bool gradients, const std::atomic<bool>& cancel,
               Workspace& workspace) const;
  // The moments of those that are elsewhere.
  bool predict_moments(std::span<const CorrectedPoint> places, const std::atomic<bool>& cancel,
                       Workspace& workspace) const;
  MomentCorrection moment_correction(const CorrectedPoint& place, const BoundaryData::Row& moments) const {
    return {elsewhere_->data(), place.origin, moments};
  }
  Randomizations::Error error(const CorrectedPoint& place, const BoundaryData::Row& moments,
                              const Randomizations& found) const;
  // From all that was found for a point, with its gradients' sums in `correction`, to its correction.
  void take_mean(const Randomizations& found, const BoundaryData::Row& moments, double summed_noise,
                 CorrectedPoint& place, std::span<float> correction) const;
  MomentCorrection::Outcome correct_moments(CorrectedPoint& place, const MomentCorrection& of_moments,
                                            std::span<const float> missing, std::span<float> correction) const;
  // Whether the correction of point i is mostly noise; nothing: `cancel` was seen set.
  std::optional<bool> is_noisy(const CorrectedPoint& place, const MomentCorrection& of_moments,
                               MomentCorrection::Outcome outcome, size_t i, std::span<const float> correction,
                               const std::atomic<bool>& cancel, Workspace& workspace) const;
  // From its walks alone, with pseudo-samples; and the correction that leads there.
  BoundaryData::Row own_coordinates(const CorrectedPoint& place, size_t i, Workspace& workspace) const;
  void take_own_coordinates(CorrectedPoint& place, const MomentCorrection& of_moments, size_t i, Workspace& workspace,
                            std::span<float> correction) const;
  void project(const Vec<3>& origin, Rows& rows) const;
  void finish(const Vec<3>& x, const CorrectedPoint& place, std::span<const float> correction, Rows& rows) const;

  const Cage<3>& cage_;
  Locator<3> locator_;
  HarmonicWalks<3> walks_;
  Projection<3> projection_;
  const HarmonicPrediction *inside_, *elsewhere_;
  const BallTables* tables_;
  Settings settings_;
};

}  // namespace barycast
