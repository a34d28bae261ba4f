#include "bind/cost.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "base/tolerances.h"
#include "bind/block_builder.h"
#include "bind/predicted_binding.h"
#include "bind/quantum.h"
#include "estimate/ball_tables.h"
#include "estimate/corrected_estimator.h"
#include "estimate/point_estimator.h"
#include "estimate/row.h"
#include "smooth/smoother.h"
#include "solve/boundary_elements.h"
#include "solve/prediction.h"

namespace barycast {
namespace {

// What depends on the data, per point: control vertices that its samples touch, entries of its row before and
// after denoising, and entries of the factor of the smoothing matrix.
struct Density {
  double touched, entries, smoothed_entries, factor_entries;
  bool exact;  // the same for every point: the worst case
};

// Samples of one point touch V f(samples / V) of V control vertices, f(x) = a x / (1 + a x): measured on spheres
// of 14 to 266 control vertices, 20 to 2,000 walks, points on inner spheres and at random; a is 2 near the
// cage and 4 near its centre, whatever V.
constexpr double kTouchRate = 3.0;
// Rays over a lattice miss less.
constexpr double kTouchRateOfRays = 8.0;
// Denoising reaches over so many times the samples of a point before contributions fall below the pruning.
constexpr double kSmoothingReach = 150.0;
// Balls that reach a point and no other one of its task: measured on seven cages with points at random, of which
// 8 reach one at the most, where the corners of as many cells meet.
constexpr double kLeavesOfPoint = 2.1, kLeavesOfPointMost = 8.0;
// A point's share of the pseudo-samples survives pruning at every vertex from this many thresholds on.
constexpr double kPseudoKept = 2.5;
// Fill of the factor under minimum degree, from 1,000 to 160,000 points: 18 to 50 on triangles and quads.
double surface_fill(double points) {
  return std::max(8.0, 4.4 * std::log2(std::max(2.0, points)) - 26.0);
}

double touched_by(double samples, const BindingSize& size, const ResolvedOptions& options) {
  const double rate = options.coordinates == CoordinateKind::kHarmonic ? kTouchRate : kTouchRateOfRays;
  const auto vertices = static_cast<double>(size.control_vertices);
  // Larger polygons spread a sample over all their corners.
  const double x = rate * samples * static_cast<double>(size.stencil_max) / 4.0 / std::max(1.0, vertices);
  return vertices * x / (1.0 + x);
}

Density expected(const BindingSize& size, const ResolvedOptions& options) {
  const auto vertices = static_cast<double>(size.control_vertices);
  const auto samples = static_cast<double>(options.samples);
  Density data{.touched = touched_by(samples, size, options),
               .entries = vertices,
               .smoothed_entries = vertices,
               .factor_entries = surface_fill(static_cast<double>(size.points)),
               .exact = false};
  const bool pseudo = options.preset != Preset::kPaper;
  if (options.estimator != Estimator::kSampling) return data;  // every vertex has a share everywhere
  if (options.prune_below > 0.0) {
    const double share = pseudo ? kPseudoSampleWeight / (vertices * samples * options.prune_below) : 0.0;
    data.entries = data.touched + (vertices - data.touched) * std::min(1.0, share / kPseudoKept);
    data.smoothed_entries = std::max(data.entries, touched_by(kSmoothingReach * samples, size, options));
  } else if (!pseudo) {
    data.entries = data.touched;
  }
  return data;
}

Density worst(const BindingSize& size, const ResolvedOptions& options) {
  const auto vertices = static_cast<double>(size.control_vertices);
  // A walk has one end; of a ray two hits are visible, but all of them count for mean value coordinates.
  const double ends = options.coordinates == CoordinateKind::kHarmonic ? 1.0 : 2.0;
  const double touched = ends * static_cast<double>(size.stencil_max) * (options.samples + 1.0);
  return {.touched = options.coordinates == CoordinateKind::kMeanValue ? vertices : std::min(vertices, touched),
          .entries = vertices,
          .smoothed_entries = vertices,
          .factor_entries = 2.0 * surface_fill(static_cast<double>(size.points)),
          .exact = true};
}

// Capacity of a vector that grew to `count` by doubling.
double grown(double count) {
  return count < 1.0 ? 0.0 : static_cast<double>(std::bit_ceil(static_cast<uint64_t>(std::ceil(count))));
}

// The same on average over counts that spread around `count` and stay below `most`.
double grown(double count, double most, const Density& data) {
  if (data.exact) return grown(std::min(count, most));
  constexpr std::array<double, 5> kSpread = {0.6, 0.8, 1.0, 1.2, 1.4};
  double sum = 0.0;
  for (const double factor : kSpread) sum += grown(std::min(most, factor * count));
  return sum / kSpread.size();
}

// Of the bound, for what the model leaves out.
constexpr double kMargin = 1.1;

template <int D>
class Model {
 public:
  Model(const BindingSize& size, const ResolvedOptions& options, const Density& data)
      : size_(size), options_(options), data_(data), points_(static_cast<double>(size.points)) {}

  double peak() const {
    const bool smoothed = options_.denoise == Denoise::kMesh;
    const double set = points_ * (kPosition + sizeof(uint32_t)) + grown(points_) * kPosition;
    const double faces = static_cast<double>(size_.faces), corners = static_cast<double>(size_.face_corners);
    const double input = points_ * kPosition + 4.0 * (faces + corners);
    const double mesh = faces > 0 ? grown(points_) * sizeof(Vec<3>) + 4.0 * faces + 4.0 * grown(corners) : 0.0;
    // While positions are looked up: their names and the table of those, and the slack of the list of nodes.
    const auto slots = static_cast<double>(std::bit_ceil(2 * std::max<uint64_t>(1, size_.points)));
    const double names = points_ * sizeof(uint64_t) + slots * sizeof(uint32_t) + (grown(points_) - points_) * kPosition;
    if (options_.estimator == Estimator::kPredicted) return predicted_peak(input, set, mesh, names);
    if (options_.estimator != Estimator::kSampling)
      return constant() +
             std::max({input + set + mesh + names, set + solving(), set + solved() + block(data_.entries)});
    if (!smoothed) return constant() + std::max(input + set + mesh + names, set + block(data_.entries));
    const double held = set + mesh + points_ * (sizeof(NodeState<D>) + 0.125) + 4.0 * vertices();
    const double smoothing = held + kernel() + columns();
    return constant() + std::max({input + set + mesh + names, input + held, held + stored_fits() + factorization(),
                                  smoothing + stored_fits(), smoothing + packed_rows(),
                                  held + kernel() + packed_rows() + block(data_.smoothed_entries)});
  }

 private:
  static constexpr double kPosition = sizeof(Vec<D>);
  static constexpr double kWalk = 64.0;  // one under way
  // Samples that room is made for, by walk or ray.
  double ends() const { return options_.coordinates == CoordinateKind::kHarmonic ? 1.0 : 2.0; }
  static constexpr double kChunk = 16.0;  // what malloc adds to a piece, rounding included
  // Edges, Laplacian and matrix per point, the ordering's workspace, and twice the factor: Eigen's and ours.
  static constexpr double kFactorizationBytes = 290.0, kFactorEntryBytes = 23.2;

  double vertices() const { return static_cast<double>(size_.control_vertices); }

  // Of every thread: moments of all control vertices, samples, walks, and a row twice while it is pruned.
  double constant() const {
    const double together = options_.samples == 0 ? 0.0 : static_cast<double>(points_per_task(options_.samples));
    const double estimate = sizeof(PointEstimate<D>) + kPosition + kChunk + fits() * sizeof(LinearFit<D>);
    const double thread = vertices() * (sizeof(Vec<D + 1>) + 8.0) +
                          options_.samples * (ends() * together * sizeof(Sample<D>) + kWalk) + together * estimate +
                          2.0 * grown(vertices()) * sizeof(RowEntry<D>) + 12'000.0;
    return 32'000.0 + vertices() * sizeof(Vec<D>) + static_cast<double>(size_.threads) * thread;
  }

  double fits() const { return grown(data_.touched, vertices(), data_); }

  double rows_per_task() const {
    return static_cast<double>(options_.estimator == Estimator::kPredicted
                                   ? predicted_rows_per_task(size_.control_vertices)
                                   : BlockBuilder<D>::kRowsPerThread);
  }

  // The rows under way, and the same packed; a vector that grows holds its old half as well, once the longest.
  double block(double entries) const {
    const double unpacked = grown(entries, vertices(), data_);
    if (options_.influences_max > 0) entries = std::min(entries, static_cast<double>(options_.influences_max));
    const double rows = static_cast<double>(std::min(size_.block_rows, size_.points));
    const double at_once = std::min(rows, rows_per_task() * static_cast<double>(size_.threads));
    const double values = grown(rows * entries), gradients = options_.gradients ? grown(rows * entries * D) : 0.0;
    return at_once * (kFinishedRow + kChunk + unpacked * sizeof(RowEntry<D>)) +
           grown(rows * entries) * sizeof(uint32_t) + (values + gradients) * sizeof(double) +
           0.5 * std::max(values, gradients) * sizeof(double) + 16.0 * rows;
  }
  static constexpr double kFinishedRow = 80.0;

  // Of boundary elements: while they are solved, and what remains with the rows of a task. Whether there are moments
  // depends on the cage and the points: they may be, and are expected in one request of three.
  double solving() const { return boundary_bytes(BoundarySolver::bytes); }
  double solved() const {
    const double kernels = 60.0 * options_.panels, rows = 16.0 * (D + 1) * vertices();
    return boundary_bytes(BoundarySolver::solved_bytes) +
           static_cast<double>(size_.threads) * sizeof(double) * (kernels + rows);
  }
  double boundary_bytes(size_t (*bytes)(const BoundarySettings&, size_t)) const {
    if (options_.panels == 0) return 0.0;
    const auto with = static_cast<double>(bytes({options_.panels, BoundarySides::kBoth}, size_.control_vertices));
    const auto without = static_cast<double>(bytes({options_.panels, BoundarySides::kInside}, size_.control_vertices));
    return data_.exact ? with : without + (with - without) / 3;
  }

  // With predictions: one is made before there is anything else, a second one, if points need it, when all are there.
  double predicted_peak(double input, double set, double mesh, double names) const {
    const auto bytes = [&](BoundarySides side) { return static_cast<double>(HarmonicPrediction::bytes(cage(), side)); };
    const auto solving = [&](BoundarySides side) {
      return static_cast<double>(HarmonicPrediction::solving_bytes(cage(), side));
    };
    const auto first = size_.closed ? BoundarySides::kInside : BoundarySides::kElsewhere;
    const bool both = size_.closed && data_.exact;
    double kept = bytes(first), made = input + solving(first);
    if (both) {
      made = std::max(made, input + set + mesh + kept + solving(BoundarySides::kElsewhere));
      kept += bytes(BoundarySides::kElsewhere);
    }
    const double before = std::max(made, input + set + mesh + names + kept);
    if (size_.closed) kept += expansions();
    const double constant = predicted_constant(both || !size_.closed);
    if (options_.denoise != Denoise::kMesh) return constant + std::max(before, set + kept + block(data_.entries));
    const double held = kept + set + mesh + points_ * (sizeof(CorrectedPoint) + correction());
    return constant + std::max({before, input + held, held + points_ * sizeof(double) + factorization(),
                                held + kernel() + correction_columns(), held + kernel() + block(data_.entries)});
  }
  // Made while there are rows to be.
  double expansions() const {
    const auto bytes = data_.exact ? LocalExpansions::most_bytes : LocalExpansions::expected_bytes;
    return static_cast<double>(bytes(size_.points, size_.control_vertices));
  }
  // A block of corrections for every thread.
  double correction_columns() const {
    const double groups = std::ceil(vertices() / static_cast<double>(HeatKernel::kColumns));
    return points_ * HeatKernel::kColumns * sizeof(float) * std::min(static_cast<double>(size_.threads), groups);
  }
  // Of a point: values, and their partial derivatives.
  double correction() const { return sizeof(float) * vertices() * (options_.gradients ? 4 : 1); }
  // Of a point: near the cage, gradients have more.
  double walks() const {
    const bool steep =
        data_.exact && options_.gradients && size_.closed && !options_.tables && options_.target_error == 0.0;
    return std::max<double>(options_.samples, steep ? CorrectedEstimator::kSteepWalksMost : 0);
  }
  // First steps: where they go, several times over, and what one walk found.
  static constexpr double kFirstStep = 96.0;
  double first_steps() const { return options_.gradients ? walks() * kFirstStep + 32.0 * vertices() : 0.0; }
  HarmonicPrediction::CageSize cage() const { return {size_.elements, size_.triangles, size_.control_vertices}; }
  // Of every thread: points that walk together with their samples, a task's points with predictions and corrections,
  // and walks.
  double predicted_constant(bool elsewhere) const {
    constexpr double kWalking = kPredictedWalkTogether;
    const size_t count = size_.control_vertices, columns = elsewhere ? 4 * count + 6 : count;
    const size_t task = predicted_rows_per_task(count);
    const double samples = walks() * (kWalking * sizeof(Sample<D>) + kWalk);
    const double found = std::max(correction(), sizeof(float) * static_cast<double>(columns));
    const double points = static_cast<double>(task) * (sizeof(CorrectedPoint) + correction()) + first_steps() +
                          kWalking * (found + (elsewhere ? sizeof(double) * static_cast<double>(columns) : 0.0));
    const double rows =
        4.0 * sizeof(double) * static_cast<double>(columns) + 2.0 * grown(vertices()) * sizeof(RowEntry<D>);
    const size_t together = std::min(task, CorrectedEstimator::kElsewhereTogether);
    const auto sums = static_cast<double>(std::max(PanelSums::evaluation_bytes(task, count, count, true),
                                                   PanelSums::evaluation_bytes(together, columns, count, true)));
    return 32'000.0 + static_cast<double>(size_.threads) *
                          (samples + points + rows + sums + rounds(kWalking, columns) + tables(kWalking) + 12'000.0);
  }
  // Of every thread: tables that a task's points miss, kept or not, while they are made, and the walks from their
  // balls.
  double tables(double points) const {
    if (!options_.tables || !size_.closed) return 0.0;
    const double leaves = points * (data_.exact ? kLeavesOfPointMost : kLeavesOfPoint);
    const double width = vertices() + 16.0, walks = 8.0 * BallTableSettings{}.walks;
    return leaves * (kHarmonics * width * sizeof(int16_t) + sizeof(BallTable) + kChunk + 3.0 * kUse) +
           walks * (sizeof(Sample<D>) + kWalk + kHarmonics * sizeof(float)) +
           ((points + 2.0) * (options_.gradients ? 4.0 : 1.0) + kHarmonics) * width * sizeof(float);
  }
  static constexpr double kUse = 32.0;  // a leaf and a point that it reaches
  // Of every thread: what the rounds of a task's points found, half of one again while it grows, and one in doubles.
  double rounds(double points, size_t columns) const {
    if (options_.target_error == 0.0) return 0.0;
    const auto found = static_cast<double>(Randomizations::kBatchesMost * columns);
    return found * (sizeof(float) * (points + 0.5) + sizeof(double)) + points * 200.0;
  }

  double factorization() const {
    // Every pair of a face's corners once, as entries to be summed, and the sparse matrix from them.
    const double corners = static_cast<double>(size_.face_corners);
    const double pairs =
        0.5 * corners * (1.0 + std::min(256.0, corners / std::max(1.0, static_cast<double>(size_.faces))));
    const double assembly = (16.0 + 12.0) * pairs + 130.0 * points_;
    return std::max(assembly, points_ * (kFactorizationBytes + kFactorEntryBytes * data_.factor_entries));
  }
  double kernel() const { return points_ * (20.0 + 8.0 * data_.factor_entries); }
  // Groups of control vertices that are smoothed together.
  double groups() const { return std::ceil(vertices() / NodeFits<D>::kGroupVertices); }
  // A node's fits, and its share of the lists that its task makes for every group.
  double stored_fits() const {
    const double task = 0.7 * static_cast<double>(points_per_task(std::max(1u, options_.samples)));
    return points_ * (data_.touched * NodeFits<D>::kFitBytes +
                      std::min(groups(), data_.touched * task) / task * (NodeFits<D>::kListBytes * 1.5 + kChunk));
  }
  double packed_rows() const {
    const double entry = 1.0 + sizeof(float) * (options_.gradients ? 1 + D : 1);
    return points_ * (data_.smoothed_entries * entry + groups() * kPackedNode);
  }
  static constexpr double kPackedNode = 2.3;  // an offset, and a share of its piece
  // A block of columns for every thread that has control vertices to smooth.
  double columns() const {
    const double block = points_ * HeatKernel::kColumns * sizeof(float);
    const double most = std::max(1.0, std::floor(Smoother<D>::kBlocksBytesMax / std::max(1.0, block)));
    return block * std::min({static_cast<double>(size_.threads), std::max(1.0, groups()), most});
  }

  const BindingSize& size_;
  const ResolvedOptions& options_;
  const Density& data_;
  const double points_;
};

uint64_t peak_bytes(const BindingSize& size, const ResolvedOptions& options, const Density& data) {
  return static_cast<uint64_t>(size.dimension == 2 ? Model<2>(size, options, data).peak()
                                                   : Model<3>(size, options, data).peak());
}

}  // namespace

uint64_t estimate_memory_bytes(const BindingSize& size, const ResolvedOptions& options) {
  return peak_bytes(size, options, expected(size, options));
}

uint64_t bound_memory_bytes(const BindingSize& size, const ResolvedOptions& options) {
  return static_cast<uint64_t>(kMargin * static_cast<double>(peak_bytes(size, options, worst(size, options))));
}

uint64_t samples_most(const ResolvedOptions& options) {
  const uint64_t rounds = options.target_error > 0.0 ? CorrectedEstimator::kRoundsMost : 1;
  const bool lines = options.coordinates != CoordinateKind::kHarmonic && options.preset != Preset::kPaper;
  return rounds * (lines ? uint64_t{options.samples} + options.samples % 2 : options.samples);
}

uint64_t estimate_samples(const BindingSize& size, const ResolvedOptions& options) {
  return size.points * samples_most(options);
}

uint64_t estimate_entries(const BindingSize& size, const ResolvedOptions& options) {
  const Density data = expected(size, options);
  double entries = options.denoise == Denoise::kMesh ? data.smoothed_entries : data.entries;
  if (options.influences_max > 0) entries = std::min(entries, static_cast<double>(options.influences_max));
  return static_cast<uint64_t>(std::llround(static_cast<double>(size.points) * entries));
}

}  // namespace barycast
