#include "bind/binding.h"

#include <algorithm>
#include <optional>
#include <span>

#include "base/workspace.h"
#include "bind/block_builder.h"
#include "bind/mesh_kernel.h"
#include "bind/predicted_binding.h"
#include "bind/quantum.h"
#include "bind/query_set.h"
#include "bind/sampler.h"
#include "bind/solved_binding.h"
#include "estimate/noise.h"
#include "estimate/point_estimator.h"
#include "estimate/row.h"
#include "smooth/smoother.h"
#include "smooth/strength.h"

namespace barycast {
namespace {

ErrorRate error_rate(const ResolvedOptions& options) {
  return options.coordinates == CoordinateKind::kHarmonic ? ErrorRate::kSquareRoot : ErrorRate::kLinear;
}

template <int D>
class BindingOf final : public Binding {
 public:
  BindingOf(std::shared_ptr<const CageIndex> index, const CageStructures<D>& structures, QuerySet<D> queries,
            const BindingSettings& settings)
      : index_(std::move(index)),
        cage_(structures.cage),
        queries_(std::move(queries)),
        settings_(settings),
        estimator_(cage_, structures.closest_points(settings.options), *structures.winding,
                   make_sampler<D>(settings.options, structures),
                   {.thickness = settings.options.thickness,
                    .seed = settings.options.seed,
                    .pseudo_samples = settings.options.preset == Preset::kPaper ? PseudoSamples::kWhenSingular
                                                                                : PseudoSamples::kAlways,
                    .closed = structures.is_closed()}),
        finisher_(cage_, {.prune_below = settings.options.prune_below,
                          .gradients = settings.options.gradients,
                          .influences_max = settings.options.influences_max}),
        blocks_(settings_, cage_.frame().diagonal),
        quantum_(1000 / settings.options.samples),  // a point costs microseconds per sample
        points_per_task_(points_per_task(settings.options.samples)),
        tasks_([this] { return Task(cage_); }) {
    summary_.warnings.assign(cage_.warnings().begin(), cage_.warnings().end());
    summary_.warnings.insert(summary_.warnings.end(), queries_.warnings.begin(), queries_.warnings.end());
    if (settings.options.unpredicted)
      summary_.warnings.push_back({"estimator",
                                   "the cage is too large to be predicted; coordinates were sampled, with several "
                                   "times the noise; more samples help, or boundary elements"});
    if (smoothed()) {
      summary_.smoothing_time = settings.options.smoothing_time.value_or(0.0);
      fits_.emplace(cage_, queries_.nodes);
      nodes_with_faces_ = queries_.mesh.nodes_with_faces();
      progress_ = {Stage::kSampling, 0, queries_.nodes.size()};
    } else {
      queries_.mesh = {};
      progress_ = {Stage::kSampling, settings.first_row, queries_.points.size()};
    }
  }

  // Where the caller did not. False: `cancel` was seen set.
  bool choose_smoothing_time(const std::atomic<bool>& cancel) {
    const std::optional<SquaredEdges> edges = squared_edges(queries_.mesh, cancel);
    if (!edges) return false;
    if (settings_.options.preset == Preset::kPaper) {
      summary_.smoothing_time = smoothing_time_as_printed(*edges, settings_.options.samples);
      return true;
    }
    const StageTimer timer(summary_.sampling_s);
    const std::optional<double> noise =
        relative_noise<D>(estimator_, cage_, queries_.nodes, settings_.options.samples, cancel);
    if (noise) summary_.smoothing_time = barycast::smoothing_time(*edges, *noise);
    return noise.has_value();
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
  // Of one thread: some points of the query set, by their places in it, and what they are found to be.
  struct Task {
    explicit Task(const Cage<D>& cage) : workspace(cage) {}
    typename PointEstimator<D>::Workspace workspace;
    std::vector<uint32_t> places;
    std::vector<Vec<D>> points;
    std::vector<PointEstimate<D>> estimates;  // of the points, and more
  };

  bool smoothed() const { return settings_.options.denoise == Denoise::kMesh; }

  Step sample_nodes(const std::atomic<bool>& cancel) {
    const StageTimer timer(summary_.sampling_s);
    const size_t count = std::min(quantum_.size(), queries_.nodes.size() - nodes_sampled_);
    const bool complete = quantum_.run(count, points_per_task_, cancel, [&](size_t begin, size_t end) {
      return sample_nodes(nodes_sampled_ + begin, nodes_sampled_ + end, cancel);
    });
    if (!complete) return Step::kCancelled;
    nodes_sampled_ += count;
    progress_.done = nodes_sampled_;
    return Step::kWorking;
  }

  bool estimate(Task& task, const std::atomic<bool>& cancel) const {
    if (task.estimates.size() < task.points.size()) task.estimates.resize(task.points.size());
    return estimator_.estimate(task.points, cancel, task.workspace,
                               std::span(task.estimates).first(task.points.size()));
  }

  // Nodes that no face names are left to their rows.
  bool sample_nodes(size_t begin, size_t end, const std::atomic<bool>& cancel) {
    Task& task = tasks_.local();
    task.places.clear();
    task.points.clear();
    for (size_t node = begin; node < end; ++node) {
      if (!nodes_with_faces_[node]) continue;
      task.places.push_back(static_cast<uint32_t>(node));
      task.points.push_back(queries_.nodes[node]);
    }
    if (!estimate(task, cancel)) return false;
    fits_->add(task.places, std::span(task.estimates).first(task.points.size()));
    return true;
  }

  // Of the nodes. None depends on another node but by the time that is given for all.
  std::vector<double> smoothing_times() const {
    const ResolvedOptions& options = settings_.options;
    if (options.preset == Preset::kPaper) return std::vector<double>(queries_.nodes.size(), summary_.smoothing_time);
    return barycast::smoothing_times(queries_.nodes.size(), summary_.smoothing_time,
                                     smoothing_time_per_squared_distance(error_rate(options), options.samples),
                                     options.thickness, [&](size_t node) { return fits_->state(node).distance; });
  }

  Step factor(const std::atomic<bool>& cancel) {
    const StageTimer timer(summary_.smoothing_factor_s);
    const std::vector<double> times = smoothing_times();
    kernel_ = find_mesh_kernel(queries_.mesh, times, settings_.kernels, cancel, summary_.warnings);
    if (!kernel_) return Step::kCancelled;
    add_counts(fits_->counts(), summary_);
    smoother_.emplace(cage_, finisher_, kernel_->kernel, *fits_);
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

  // Finishes the rows of some points, from their smoothed entries or from their own samples.
  bool finish_rows(size_t first, const std::atomic<bool>& cancel, std::span<FinishedRow<D>> rows) {
    Task& task = tasks_.local();
    task.places.clear();
    task.points.clear();
    for (size_t i = 0; i < rows.size(); ++i) {
      const uint32_t node = queries_.node_of_point[first + i];
      if (smoothed() && kernel_->kernel.smooths(node)) {
        smoother_->row(node, rows[i].entries);
        rows[i].flags = fits_->state(node).flags;
        rows[i].error = finisher_.finish(queries_.points[first + i], rows[i].entries);
      } else {
        task.places.push_back(static_cast<uint32_t>(i));
        task.points.push_back(queries_.points[first + i]);
      }
    }
    if (!estimate(task, cancel)) return false;
    for (size_t k = 0; k < task.points.size(); ++k) {
      const PointEstimate<D>& own = task.estimates[k];
      FinishedRow<D>& row = rows[task.places[k]];
      finisher_.evaluate(own.projected, task.points[k], row.entries);
      row.flags = own.flags;
      // A node that denoising left alone was counted when it was first sampled.
      const size_t node = queries_.node_of_point[first + task.places[k]];
      if (!smoothed() || !nodes_with_faces_[node]) row.counts = own.counts;
      row.error = finisher_.finish(task.points[k], row.entries);
    }
    return true;
  }

  Step make_rows(const std::atomic<bool>& cancel) {
    const StageTimer timer(smoothed() ? summary_.rows_s : summary_.sampling_s);
    const Step step = blocks_.advance(
        queries_.points.size(), quantum_, points_per_task_, cancel,
        [&](size_t first, std::span<FinishedRow<D>> rows) { return finish_rows(first, cancel, rows); }, block_,
        summary_);
    progress_.done = blocks_.next_row();
    return step;
  }

  std::shared_ptr<const CageIndex> index_;  // keeps cage_ alive
  const Cage<D>& cage_;
  QuerySet<D> queries_;
  BindingSettings settings_;
  PointEstimator<D> estimator_;
  RowFinisher<D> finisher_;
  BlockBuilder<D> blocks_;
  Quantum quantum_;
  const size_t points_per_task_;

  PerThread<Task> tasks_;

  // With denoising only.
  std::optional<NodeFits<D>> fits_;
  std::vector<bool> nodes_with_faces_;
  size_t nodes_sampled_ = 0;
  KernelCache::Kernel kernel_;
  std::optional<Smoother<D>> smoother_;

  RowBlock block_;
  Progress progress_;
  BindingSummary summary_;
};

template <int D>
Result<std::unique_ptr<Binding>> create_of(std::shared_ptr<const CageIndex> index, const CageStructures<D>& structures,
                                           const QueryInput& input, const BindingSettings& asked,
                                           const std::atomic<bool>& cancel) {
  BindingSettings settings = asked;
  settings.options = index->settle(asked.options);
  if (auto status = check_dimension(settings.options, D); !status) return status.error();
  if (auto status = check_estimator(structures.cage, settings.options); !status) return status.error();
  if (auto status = index->prepare(settings.options); !status) return status.error();
  auto queries = QuerySet<D>::create(input, structures.cage.frame(), cancel);
  if (!queries) return queries.error();
  if (settings.first_row >= queries->points.size())
    return invalid_argument("resume.first_row",
                            "must be below the number of query points, " + std::to_string(queries->points.size()));
  if constexpr (D == 3) {
    if (settings.options.estimator == Estimator::kPredicted)
      return create_predicted_binding(std::move(index), structures, std::move(*queries), settings, cancel);
    if (settings.options.estimator != Estimator::kSampling)
      return create_solved_binding(std::move(index), structures, std::move(*queries), settings, cancel);
  }
  auto binding = std::make_unique<BindingOf<D>>(std::move(index), structures, std::move(queries).value(), settings);
  const bool given = settings.options.denoise == Denoise::kNone || settings.options.smoothing_time;
  if (!given && !binding->choose_smoothing_time(cancel))
    return Error{ErrorCode::kCancelled, "", "the request was cancelled"};
  return std::unique_ptr<Binding>(std::move(binding));
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
