#include "bind/binding.h"

#include <algorithm>
#include <chrono>
#include <optional>

#include "base/parallel.h"
#include "base/workspace.h"
#include "bind/query_set.h"
#include "estimate/point_estimator.h"
#include "estimate/row.h"
#include "smooth/smoother.h"
#include "smooth/strength.h"

namespace barycast {
namespace {

// Squared diagonals; the heat kernel then reaches over about a tenth of the cage.
constexpr double kSmoothingTimeLarge = 0.01;

using Clock = std::chrono::steady_clock;

// Adds the life time of the object to `seconds`.
class StageTimer {
 public:
  explicit StageTimer(double& seconds) : seconds_(seconds), start_(Clock::now()) {}
  ~StageTimer() { seconds_ += elapsed(); }
  double elapsed() const { return std::chrono::duration<double>(Clock::now() - start_).count(); }
  StageTimer(const StageTimer&) = delete;
  StageTimer& operator=(const StageTimer&) = delete;

 private:
  double& seconds_;
  Clock::time_point start_;
};

// How many points one call of `advance` handles: as many as fill kQuantum of wall time, learnt from the
// calls before. It cuts work into pieces and changes no result.
class Quantum {
 public:
  // The first guess: a point costs microseconds per sample.
  explicit Quantum(uint32_t samples) : size_(std::clamp<size_t>(1000 / samples, 1, 16)) {}
  size_t size() const { return size_; }
  void learn(size_t done, double seconds) {
    if (done < size_) return;
    if (seconds < 0.5 * kQuantumSeconds) size_ = std::min<size_t>(2 * size_, 1 << 16);
    if (seconds > 1.5 * kQuantumSeconds) size_ = std::max<size_t>(size_ / 2, 1);
  }

 private:
  static constexpr double kQuantumSeconds = 0.02;
  size_t size_;
};

template <int D>
Sampler<D> make_sampler(const ResolvedOptions& options, const CageStructures<D>& structures) {
  const bool paper = options.preset == Preset::kPaper;
  if (options.coordinates != CoordinateKind::kHarmonic)
    return RaySamples<D>(structures.cage, *structures.lines,
                         {.rays = options.samples,
                          .visible_only = options.coordinates == CoordinateKind::kPositiveMeanValue,
                          .as_printed = paper});
  return HarmonicWalks<D>(*structures.distance, {.walks = options.samples,
                                                 .thickness = options.thickness,
                                                 .walk_steps_max = options.walk_steps_max,
                                                 .run_on = !paper});
}

double default_smoothing_time(const ResolvedOptions& options, const SquaredEdges& edges) {
  if (options.preset == Preset::kPaper) return smoothing_time_as_printed(edges, options.samples);
  const bool rays = options.coordinates != CoordinateKind::kHarmonic;
  return smoothing_time(edges, rays ? ErrorRate::kLinear : ErrorRate::kSquareRoot, options.samples);
}

template <int D>
class BindingOf final : public Binding {
 public:
  BindingOf(std::shared_ptr<const CageIndex> index, const CageStructures<D>& structures, QuerySet<D> queries,
            const BindingSettings& settings, double smoothing_time)
      : index_(std::move(index)),
        cage_(structures.cage),
        queries_(std::move(queries)),
        settings_(settings),
        estimator_(cage_, *structures.distance, *structures.winding, make_sampler<D>(settings.options, structures),
                   {.thickness = settings.options.thickness,
                    .seed = settings.options.seed,
                    .pseudo_samples = settings.options.preset == Preset::kPaper ? PseudoSamples::kWhenSingular
                                                                                : PseudoSamples::kAlways}),
        finisher_(cage_, {.prune_below = settings.options.prune_below,
                          .gradients = settings.options.gradients,
                          .influences_max = settings.options.influences_max}),
        quantum_(settings.options.samples),
        workspaces_([this] { return typename PointEstimator<D>::Workspace(cage_); }) {
    summary_.warnings.assign(cage_.warnings().begin(), cage_.warnings().end());
    summary_.warnings.insert(summary_.warnings.end(), queries_.warnings.begin(), queries_.warnings.end());
    if (smoothed()) {
      summary_.smoothing_time = smoothing_time;
      estimates_.resize(queries_.nodes.size());
      progress_ = {Stage::kSampling, 0, queries_.nodes.size()};
    } else {
      queries_.mesh = {};
      progress_ = {Stage::kSampling, settings.first_row, queries_.points.size()};
    }
    next_row_ = settings.first_row;
  }

  Step advance(const std::atomic<bool>& cancel) override {
    if (cancel) return Step::kCancelled;
    if (smoothed() && nodes_sampled_ < queries_.nodes.size()) return sample_nodes(cancel);
    if (smoothed() && !smoother_) return factor(cancel);
    if (smoothed() && smoother_->groups_done() < smoother_->group_count()) return smooth(cancel);
    return make_rows(cancel);
  }

  RowBlock take_block() override { return std::exchange(block_, {}); }
  Progress progress() const override { return progress_; }
  const BindingSummary& summary() const override { return summary_; }
  double smoothing_time() const override { return summary_.smoothing_time; }

 private:
  // A finished row and what it says about itself, before it is packed.
  struct FinishedRow {
    std::vector<RowEntry<D>> entries;
    double error = 0.0;
    uint8_t flags = 0;
    SampleCounts counts;
  };

  bool smoothed() const { return settings_.options.denoise == Denoise::kMesh; }

  // Runs body(i) for the next `count` points of a quantum; false when cancelled on the way.
  template <class Body>
  bool run_quantum(size_t count, const std::atomic<bool>& cancel, const Body& body) {
    const StageTimer timer(ignored_);
    std::atomic<bool> complete = true;
    parallel_for(count, count < kPointsPerTask * parallel_width() ? 1 : kPointsPerTask, [&](size_t begin, size_t end) {
      for (size_t i = begin; i < end; ++i)
        if (!complete.load(std::memory_order_relaxed) || !body(i)) complete = false;
    });
    quantum_.learn(count, timer.elapsed());
    return complete && !cancel;
  }

  Step sample_nodes(const std::atomic<bool>& cancel) {
    const StageTimer timer(summary_.sampling_s);
    const size_t count = std::min(quantum_.size(), queries_.nodes.size() - nodes_sampled_);
    const bool complete = run_quantum(count, cancel, [&](size_t i) {
      const size_t node = nodes_sampled_ + i;
      return estimator_.estimate(queries_.nodes[node], cancel, workspaces_.local(), estimates_[node]);
    });
    if (!complete) return Step::kCancelled;
    for (size_t i = 0; i < count; ++i) add_counts(estimates_[nodes_sampled_ + i].counts);
    nodes_sampled_ += count;
    progress_.done = nodes_sampled_;
    return Step::kWorking;
  }

  Step factor(const std::atomic<bool>& cancel) {
    const StageTimer timer(summary_.smoothing_factor_s);
    if (summary_.smoothing_time > kSmoothingTimeLarge)
      summary_.warnings.push_back({"smoothing_time",
                                   "denoising averages over a tenth of the cage and more, for the mesh has "
                                   "very long edges; leave them out, or set a smaller time"});
    const std::optional<MeshLaplacian> assembled = polygon_laplacian(queries_.mesh, cancel);
    if (!assembled) return Step::kCancelled;
    const MeshLaplacian& laplacian = *assembled;
    if (laplacian.faces_skipped > 0)
      summary_.warnings.push_back(
          {"faces", std::to_string(laplacian.faces_skipped) +
                        " faces without area (or with more than 256 corners) do not take part in denoising"});
    if (const auto isolated = (laplacian.area.array() <= 0.0).count(); isolated > 0)
      summary_.warnings.push_back(
          {"points", std::to_string(isolated) + " positions belong to no face with area and were not denoised"});
    auto kernel = HeatKernel::create(laplacian, summary_.smoothing_time);
    if (!kernel) {
      // The faces are at fault, and the rows are right without them, only noisier: the summary says so.
      summary_.warnings.push_back({"faces", kernel.error().message});
      kernel = HeatKernel::create(MeshLaplacian{{}, Eigen::VectorXd::Zero(laplacian.area.size()), 0}, 0.0);
    }
    kernel_.emplace(std::move(kernel).value());
    smoother_.emplace(cage_, finisher_, *kernel_, queries_.nodes, estimates_);
    progress_ = {Stage::kSmoothing, 0, smoother_->group_count()};
    return Step::kWorking;
  }

  Step smooth(const std::atomic<bool>& cancel) {
    const StageTimer timer(summary_.smoothing_solve_s);
    if (!smoother_->advance(cancel)) return Step::kCancelled;
    progress_.done = smoother_->groups_done();
    if (smoother_->groups_done() == smoother_->group_count())
      progress_ = {Stage::kRows, settings_.first_row, queries_.points.size()};
    return Step::kWorking;
  }

  // Finishes the row of one point, from its smoothed entries or from its own samples.
  bool finish_row(size_t point, const std::atomic<bool>& cancel, FinishedRow& row) {
    const Vec<D>& x = queries_.points[point];
    if (smoothed()) {
      const uint32_t node = queries_.node_of_point[point];
      row.entries = smoother_->row(node);
      row.flags = estimates_[node].flags;
    } else {
      PointEstimate<D> estimate;
      if (!estimator_.estimate(x, cancel, workspaces_.local(), estimate)) return false;
      finisher_.evaluate(estimate.projected, x, row.entries);
      row.flags = estimate.flags;
      row.counts = estimate.counts;
    }
    row.error = finisher_.finish(x, row.entries);
    return true;
  }

  Step make_rows(const std::atomic<bool>& cancel) {
    const StageTimer timer(smoothed() ? summary_.rows_s : summary_.sampling_s);
    if (next_row_ == queries_.points.size() && rows_.empty()) return Step::kDone;
    const size_t block_left = settings_.block_rows - rows_.size();
    const size_t count = std::min({quantum_.size(), block_left, queries_.points.size() - next_row_});
    const size_t first = rows_.size();
    rows_.resize(first + count);
    if (!run_quantum(count, cancel, [&](size_t i) { return finish_row(next_row_ + i, cancel, rows_[first + i]); }))
      return Step::kCancelled;
    for (size_t i = first; i < rows_.size(); ++i) add_counts(rows_[i].counts);
    next_row_ += count;
    progress_.done = next_row_;
    if (rows_.size() < settings_.block_rows && next_row_ < queries_.points.size()) return Step::kWorking;
    pack_block();
    return Step::kBlock;
  }

  void pack_block() {
    block_ = {};
    block_.first_row = next_row_ - rows_.size();
    block_.offsets.push_back(0);
    for (const FinishedRow& row : rows_) {
      for (const RowEntry<D>& entry : row.entries) {
        block_.indices.push_back(entry.vertex);
        block_.values.push_back(entry.value);
        if (settings_.options.gradients)
          for (int k = 0; k < D; ++k) block_.gradients.push_back(entry.gradient[k] / cage_.frame().diagonal);
      }
      block_.offsets.push_back(static_cast<uint32_t>(block_.indices.size()));
      block_.flags.push_back(row.flags);
      summary_.linear_precision_error_max = std::max(summary_.linear_precision_error_max, row.error);
      summary_.rows_on_cage += (row.flags & kRowOnCage) != 0;
      summary_.rows_outside += (row.flags & kRowOutside) != 0;
      summary_.rows_few_samples += (row.flags & kRowFewSamples) != 0;
      summary_.rows_no_samples += (row.flags & kRowNoSamples) != 0;
      summary_.rows_rank_deficient += (row.flags & kRowRankDeficient) != 0;
    }
    summary_.rows += rows_.size();
    summary_.entries += block_.indices.size();
    rows_.clear();
  }

  void add_counts(const SampleCounts& counts) {
    summary_.samples += counts.started;
    summary_.walk_steps += counts.steps;
    summary_.walks_capped += counts.capped;
    summary_.walks_discarded += counts.discarded;
    summary_.walk_reentries += counts.reentries;
  }

  static constexpr size_t kPointsPerTask = 4;

  std::shared_ptr<const CageIndex> index_;  // keeps cage_ alive
  const Cage<D>& cage_;
  QuerySet<D> queries_;
  BindingSettings settings_;
  PointEstimator<D> estimator_;
  RowFinisher<D> finisher_;
  Quantum quantum_;
  PerThread<typename PointEstimator<D>::Workspace> workspaces_;
  double ignored_ = 0.0;

  std::vector<PointEstimate<D>> estimates_;  // of the nodes; with denoising only
  size_t nodes_sampled_ = 0;
  std::optional<HeatKernel> kernel_;
  std::optional<Smoother<D>> smoother_;

  uint64_t next_row_ = 0;
  std::vector<FinishedRow> rows_;  // of the block under way
  RowBlock block_;
  Progress progress_;
  BindingSummary summary_;
};

template <int D>
Result<std::unique_ptr<Binding>> create_of(std::shared_ptr<const CageIndex> index, const CageStructures<D>& structures,
                                           const QueryInput& input, const BindingSettings& settings,
                                           const std::atomic<bool>& cancel) {
  if (auto status = check_dimension(settings.options, D); !status) return status.error();
  auto queries = QuerySet<D>::create(input, structures.cage.frame(), cancel);
  if (!queries) return queries.error();
  if (settings.first_row >= queries->points.size())
    return invalid_argument("resume.first_row",
                            "must be below the number of query points, " + std::to_string(queries->points.size()));
  double smoothing_time = settings.options.smoothing_time.value_or(0.0);
  if (settings.options.denoise == Denoise::kMesh && !settings.options.smoothing_time) {
    const std::optional<SquaredEdges> edges = squared_edges(queries->mesh, cancel);
    if (!edges) return Error{ErrorCode::kCancelled, "", "the request was cancelled"};
    smoothing_time = default_smoothing_time(settings.options, *edges);
  }
  return std::unique_ptr<Binding>(std::make_unique<BindingOf<D>>(std::move(index), structures,
                                                                 std::move(queries).value(), settings, smoothing_time));
}

}  // namespace

Result<std::unique_ptr<Binding>> Binding::create(std::shared_ptr<const CageIndex> index, QueryInput queries,
                                                 const BindingSettings& settings, const std::atomic<bool>& cancel) {
  BARYCAST_CHECK_OP(settings.block_rows, >, 0u);
  const auto& structures = index->structures();
  return std::visit([&](const auto& s) { return create_of(std::move(index), *s, queries, settings, cancel); },
                    structures);
}

Result<RowBlock> bind_all(std::shared_ptr<const CageIndex> index, QueryInput queries, const ResolvedOptions& options,
                          BindingSummary* summary) {
  auto binding = Binding::create(std::move(index), std::move(queries), {.options = options, .block_rows = 0xFFFFFFFFu});
  if (!binding) return binding.error();
  const std::atomic<bool> never = false;
  RowBlock block;
  for (;;) {
    const Binding::Step step = (*binding)->advance(never);
    if (step == Binding::Step::kBlock) block = (*binding)->take_block();
    if (step == Binding::Step::kDone) break;
  }
  if (summary != nullptr) *summary = (*binding)->summary();
  return block;
}

}  // namespace barycast
