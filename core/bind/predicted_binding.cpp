#include "bind/predicted_binding.h"

#include <algorithm>

#include "base/parallel.h"
#include "base/workspace.h"
#include "bind/block_builder.h"
#include "bind/mesh_kernel.h"
#include "bind/quantum.h"
#include "estimate/corrected_estimator.h"
#include "smooth/strength.h"

namespace barycast {
namespace {

constexpr size_t kColumns = HeatKernel::kColumns;

class PredictedBinding final : public Binding {
 public:
  PredictedBinding(std::shared_ptr<const CageIndex> index, const CageStructures<3>& structures, QuerySet<3> queries,
                   const BindingSettings& settings)
      : index_(std::move(index)),
        cage_(structures.cage),
        queries_(std::move(queries)),
        settings_(settings),
        estimator_(cage_, *structures.walks, *structures.winding,
                   HarmonicWalks<3>(*structures.walks, {.walks = settings.options.samples,
                                                        .thickness = settings.options.thickness,
                                                        .walk_steps_max = settings.options.walk_steps_max}),
                   structures.inside.get(), structures.elsewhere.get(),
                   settings.options.tables ? structures.tables.get() : nullptr,
                   {.thickness = settings.options.thickness,
                    .seed = settings.options.seed,
                    .gradients = settings.options.gradients,
                    .closed = structures.is_closed()}),
        finisher_(cage_, {.prune_below = settings.options.prune_below,
                          .gradients = settings.options.gradients,
                          .influences_max = settings.options.influences_max}),
        rows_per_task_(predicted_rows_per_task(estimator_.columns())),
        blocks_(settings_, cage_.frame().diagonal, rows_per_task_),
        quantum_(1000 / settings.options.samples),
        tasks_([] { return Task(); }) {
    summary_.warnings.assign(cage_.warnings().begin(), cage_.warnings().end());
    summary_.warnings.insert(summary_.warnings.end(), queries_.warnings.begin(), queries_.warnings.end());
    if (settings.options.tables && !structures.is_closed())
      summary_.warnings.push_back({"tables",
                                   "the cage has none, for it is open, or its faces do not all face one way; all "
                                   "points walked"});
    if (smoothed()) {
      places_.resize(queries_.nodes.size());
      corrections_.resize(queries_.nodes.size() * estimator_.row_size());
      progress_ = {Stage::kSampling, 0, queries_.nodes.size()};
    } else {
      queries_.mesh = {};
      progress_ = {Stage::kSampling, settings.first_row, queries_.points.size()};
    }
  }

  // Where the caller did not. False: `cancel` was seen set.
  bool choose_smoothing_time(const std::atomic<bool>& cancel) {
    if (settings_.options.smoothing_time) {
      summary_.smoothing_time = *settings_.options.smoothing_time;
      return true;
    }
    const std::optional<SquaredEdges> edges = squared_edges(queries_.mesh, cancel);
    if (!edges) return false;
    summary_.smoothing_time = smoothing_time_of_corrections(*edges);
    return true;
  }

  Step advance(const std::atomic<bool>& cancel) override {
    if (cancel) return Step::kCancelled;
    if (smoothed() && nodes_sampled_ < queries_.nodes.size()) return sample_nodes(cancel);
    if (smoothed() && !kernel_) return factor(cancel);
    if (smoothed() && groups_done_ < group_count()) return smooth(cancel);
    return make_rows(cancel);
  }

  RowBlock take_block() override { return std::exchange(block_, {}); }
  Progress progress() const override { return progress_; }
  const BindingSummary& summary() const override { return summary_; }
  double smoothing_time() const override { return summary_.smoothing_time; }

 private:
  struct Task {
    CorrectedEstimator::Workspace workspace;
    std::vector<CorrectedPoint> places;
    std::vector<float> corrections;
    std::vector<Randomizations::Error> errors;
  };

  bool targeted() const { return settings_.options.target_error > 0.0; }
  bool smoothed() const { return settings_.options.denoise == Denoise::kMesh; }
  size_t columns() const { return estimator_.columns(); }
  size_t row_size() const { return estimator_.row_size(); }
  size_t group_count() const { return (columns() + kColumns - 1) / kColumns; }

  Step sample_nodes(const std::atomic<bool>& cancel) {
    const StageTimer timer(summary_.sampling_s);
    const size_t first = nodes_sampled_, count = std::min(quantum_.size(), queries_.nodes.size() - first);
    const bool complete = quantum_.run(count, kPredictedWalkTogether, cancel, [&](size_t begin, size_t end) {
      const size_t from = first + begin, size = end - begin;
      return estimator_.correct(std::span(queries_.nodes).subspan(from, size), cancel, tasks_.local().workspace,
                                std::span(places_).subspan(from, size),
                                std::span(corrections_).subspan(from * row_size(), size * row_size()));
    });
    if (!complete) return Step::kCancelled;
    nodes_sampled_ += count;
    progress_.done = nodes_sampled_;
    return Step::kWorking;
  }

  std::vector<double> smoothing_times() const {
    return barycast::smoothing_times(
        queries_.nodes.size(), summary_.smoothing_time,
        smoothing_time_per_squared_distance(ErrorRate::kSquareRoot, settings_.options.samples),
        settings_.options.thickness, [&](size_t node) { return places_[node].distance; });
  }

  Step factor(const std::atomic<bool>& cancel) {
    const StageTimer timer(summary_.smoothing_factor_s);
    kernel_ = find_mesh_kernel(queries_.mesh, smoothing_times(), settings_.kernels, cancel, summary_.warnings);
    if (!kernel_) return Step::kCancelled;
    for (const CorrectedPoint& place : places_) add_counts(place.counts, summary_);
    progress_ = {Stage::kSmoothing, 0, group_count()};
    return Step::kWorking;
  }

  // A group of columns for every thread, in place; nodes on the cage keep their own.
  Step smooth(const std::atomic<bool>& cancel) {
    const StageTimer timer(summary_.smoothing_solve_s);
    const size_t count = std::min(parallel_width(), group_count() - groups_done_), nodes = queries_.nodes.size();
    std::atomic<bool> complete = true;
    parallel_for(count, 1, [&](size_t begin, size_t end) {
      std::vector<float> block(nodes * kColumns);
      for (size_t g = groups_done_ + begin; g < groups_done_ + end; ++g) {
        const size_t first = g * kColumns, width = std::min(kColumns, columns() - first);
        for (size_t node = 0; node < nodes; ++node) {
          float* const row = &block[kernel_->kernel.place(node) * kColumns];
          std::copy_n(&corrections_[node * row_size() + first], width, row);
          std::fill(row + width, row + kColumns, 0.0f);
        }
        if (!kernel_->kernel.smooth(block, cancel)) complete = false;
        for (size_t node = 0; node < nodes && complete; ++node)
          if (kernel_->kernel.smooths(node))
            std::copy_n(&block[kernel_->kernel.place(node) * kColumns], width,
                        &corrections_[node * row_size() + first]);
      }
    });
    if (!complete) return Step::kCancelled;
    groups_done_ += count;
    progress_.done = groups_done_;
    if (groups_done_ == group_count()) progress_ = {Stage::kRows, settings_.first_row, queries_.points.size()};
    return Step::kWorking;
  }

  bool finish_rows(size_t first, const std::atomic<bool>& cancel, std::span<FinishedRow<3>> rows) {
    Task& task = tasks_.local();
    task.places.resize(rows.size());
    task.corrections.resize(rows.size() * row_size());
    const std::span<const Vec<3>> points = std::span(queries_.points).subspan(first, rows.size());
    if (smoothed()) {
      for (size_t i = 0; i < rows.size(); ++i) {
        const size_t node = queries_.node_of_point[first + i];
        task.places[i] = places_[node];
        std::copy_n(&corrections_[node * row_size()], row_size(), &task.corrections[i * row_size()]);
      }
    } else {
      task.errors.resize(targeted() ? points.size() : 0);
      for (size_t begin = 0; begin < points.size(); begin += kPredictedWalkTogether)
        if (!correct(points, begin, std::min(kPredictedWalkTogether, points.size() - begin), cancel, task))
          return false;
    }
    return estimator_.evaluate(points, task.places, task.corrections, cancel, task.workspace,
                               [&](size_t i, const CorrectedEstimator::Rows& evaluated) {
                                 finish_row(points[i], task.places[i], evaluated, rows[i]);
                                 if (targeted()) rows[i].noise = task.errors[i];
                               });
  }

  // Some of a task's points.
  bool correct(std::span<const Vec<3>> points, size_t first, size_t count, const std::atomic<bool>& cancel,
               Task& task) const {
    const auto some = points.subspan(first, count);
    const auto places = std::span(task.places).subspan(first, count);
    const auto corrections = std::span(task.corrections).subspan(first * row_size(), count * row_size());
    if (!targeted()) return estimator_.correct(some, cancel, task.workspace, places, corrections);
    return estimator_.correct_to(settings_.options.target_error, some, cancel, task.workspace, places, corrections,
                                 std::span(task.errors).subspan(first, count));
  }

  void finish_row(const Vec<3>& x, const CorrectedPoint& place, const CorrectedEstimator::Rows& evaluated,
                  FinishedRow<3>& row) const {
    Eigen::Index column = 0;
    for (const uint32_t v : cage_.used_vertices()) {
      RowEntry<3> entry{v, evaluated.values[column], Vec<3>::Zero()};
      if (settings_.options.gradients)
        for (Eigen::Index a = 0; a < 3; ++a) entry.gradient[a] = evaluated.gradients[static_cast<size_t>(a)][column];
      row.entries.push_back(entry);
      ++column;
    }
    row.flags = place.flags;
    if (!smoothed()) row.counts = place.counts;
    row.error = finisher_.finish(x, row.entries);
  }

  Step make_rows(const std::atomic<bool>& cancel) {
    const StageTimer timer(smoothed() ? summary_.rows_s : summary_.sampling_s);
    const Step step = blocks_.advance(
        queries_.points.size(), quantum_, rows_per_task_, cancel,
        [&](size_t first, std::span<FinishedRow<3>> rows) { return finish_rows(first, cancel, rows); }, block_,
        summary_);
    progress_.done = blocks_.next_row();
    return step;
  }

  std::shared_ptr<const CageIndex> index_;  // keeps cage_ alive
  const Cage<3>& cage_;
  QuerySet<3> queries_;
  BindingSettings settings_;
  CorrectedEstimator estimator_;
  RowFinisher<3> finisher_;
  const size_t rows_per_task_;
  BlockBuilder<3> blocks_;
  Quantum quantum_;
  PerThread<Task> tasks_;

  // With denoising only: of the nodes.
  std::vector<CorrectedPoint> places_;
  std::vector<float> corrections_;  // nodes x row_size(); of gradients nothing is smoothed
  size_t nodes_sampled_ = 0;
  KernelCache::Kernel kernel_;
  size_t groups_done_ = 0;

  RowBlock block_;
  Progress progress_;
  BindingSummary summary_;
};

// Whether samples of all points of a closed cage start inside. Ends early, with false, at a point whose do not, or when
// cancelled.
bool all_start_inside(const CageStructures<3>& structures, const BallTables* tables, std::span<const Vec<3>> points,
                      double thickness, const std::atomic<bool>& cancel) {
  const Locator<3> locator(structures.cage, *structures.walks, *structures.winding, thickness);
  std::atomic<bool> all = true;
  parallel_for(points.size(), 256, [&](size_t begin, size_t end) {
    std::vector<SampleQuery<3>> query;
    std::array<Located<3>, 1> place;
    InsideTest<3> inside_test(*structures.winding, true);
    for (size_t i = begin; i < end && all && !cancel; ++i) {
      if (tables != nullptr && tables->cover().clearance(points[i]) > thickness) continue;
      bool inside;
      const double radius = (*structures.walks).free_radius(points[i]);
      if (radius > 2 * thickness) {  // surely not on the cage
        inside = inside_test(points[i], radius);
      } else {
        locator.locate(points.subspan(i, 1), 0, query, place);
        inside = !starts_outside(place[0], query[0].origin, *structures.winding);
      }
      if (!inside) all = false;
    }
  });
  return all && !cancel;
}

}  // namespace

Result<std::unique_ptr<Binding>> create_predicted_binding(std::shared_ptr<const CageIndex> index,
                                                          const CageStructures<3>& structures, QuerySet<3> queries,
                                                          const BindingSettings& settings,
                                                          const std::atomic<bool>& cancel) {
  // What is inside a closed cage was prepared with it; whether points are elsewhere the cage cannot know.
  const BallTables* const tables = settings.options.tables ? structures.tables.get() : nullptr;
  if (structures.is_closed() &&
      !all_start_inside(structures, tables, queries.points, settings.options.thickness, cancel)) {
    if (cancel) return Error{ErrorCode::kCancelled, "", "the request was cancelled"};
    const Status built = wait_for([&](std::function<void(Status)> then) {
      prepare_prediction(structures, BoundarySides::kElsewhere, std::move(then));
    });
    if (!built) return built.error();
  }
  auto binding = std::make_unique<PredictedBinding>(std::move(index), structures, std::move(queries), settings);
  if (settings.options.denoise == Denoise::kMesh && !binding->choose_smoothing_time(cancel))
    return Error{ErrorCode::kCancelled, "", "the request was cancelled"};
  return std::unique_ptr<Binding>(std::move(binding));
}

}  // namespace barycast
