#include "bind/solved_binding.h"

#include <algorithm>

#include "bind/block_builder.h"
#include "bind/quantum.h"
#include "estimate/row.h"
#include "query/winding.h"
#include "solve/boundary_elements.h"
#include "solve/exact_mean_value.h"

namespace barycast {
namespace {

class SolvedBinding final : public Binding {
 public:
  // Either a solution or a solver that is going to make one.
  SolvedBinding(std::shared_ptr<const CageIndex> index, const CageStructures<3>& structures, QuerySet<3> queries,
                const BindingSettings& settings, std::unique_ptr<const Solution<3>> solution,
                std::unique_ptr<BoundarySolver> solver)
      : index_(std::move(index)),
        structures_(structures),
        queries_(std::move(queries)),
        settings_(settings),
        solution_(std::move(solution)),
        solver_(std::move(solver)),
        finisher_(structures.cage, {.prune_below = settings.options.prune_below,
                                    .gradients = settings.options.gradients,
                                    .influences_max = settings.options.influences_max}),
        blocks_(settings_, structures.cage.frame().diagonal),
        quantum_(kPointsPerTask) {
    queries_.mesh = {};
    const auto warnings = structures.cage.warnings();
    summary_.warnings.assign(warnings.begin(), warnings.end());
    summary_.warnings.insert(summary_.warnings.end(), queries_.warnings.begin(), queries_.warnings.end());
    report_rows();
    if (solver_) progress_ = {Stage::kSolving, 0, solver_->total()};
  }

  Step advance(const std::atomic<bool>& cancel) override {
    if (cancel) return Step::kCancelled;
    return solver_ ? solve() : make_rows(cancel);
  }

  RowBlock take_block() override { return std::exchange(block_, {}); }
  Progress progress() const override { return progress_; }
  const BindingSummary& summary() const override { return summary_; }
  double smoothing_time() const override { return 0.0; }

 private:
  void report_rows() { progress_ = {Stage::kRows, blocks_.next_row(), queries_.points.size()}; }

  Step solve() {
    const StageTimer timer(summary_.solving_s);
    solver_->advance();
    progress_.done = solver_->done();
    if (solver_->done() < solver_->total()) return Step::kWorking;
    for (Warning& warning : solver_->warnings()) summary_.warnings.push_back(std::move(warning));
    solution_ = solver_->take(structures_.closest_points(settings_.options), *structures_.winding);
    solver_.reset();
    report_rows();
    return Step::kWorking;
  }

  void finish_rows(size_t first_point, std::span<FinishedRow<3>> rows) const {
    const std::span<const Vec<3>> points = std::span(queries_.points).subspan(first_point, rows.size());
    const bool gradients = settings_.options.gradients;
    SolvedRows<3> solved;
    solution_->evaluate(points, gradients, solved);
    for (size_t i = 0; i < rows.size(); ++i) {
      const auto at = static_cast<Eigen::Index>(i);
      FinishedRow<3>& row = rows[i];
      for (const uint32_t v : structures_.cage.used_vertices()) {
        RowEntry<3> entry{v, solved.values(at, v), Vec<3>::Zero()};
        if (gradients)
          entry.gradient = {solved.gradients[0](at, v), solved.gradients[1](at, v), solved.gradients[2](at, v)};
        row.entries.push_back(entry);
      }
      row.error = finisher_.finish(points[i], row.entries);
      if (solved.on_cage[i] != 0) row.flags |= kRowOnCage;
      if (solved.rank_deficient[i] != 0) row.flags |= kRowRankDeficient;
      if (!structures_.winding->inside(points[i])) row.flags |= kRowOutside;
    }
  }

  Step make_rows(const std::atomic<bool>& cancel) {
    const StageTimer timer(summary_.rows_s);
    const Step step = blocks_.advance(
        queries_.points.size(), quantum_, kPointsPerTask, cancel,
        [&](size_t first, std::span<FinishedRow<3>> rows) {
          finish_rows(first, rows);
          return !cancel.load(std::memory_order_relaxed);
        },
        block_, summary_);
    progress_.done = blocks_.next_row();
    return step;
  }

  static constexpr size_t kPointsPerTask = 16;

  std::shared_ptr<const CageIndex> index_;  // keeps structures_ alive
  const CageStructures<3>& structures_;
  QuerySet<3> queries_;
  BindingSettings settings_;
  std::unique_ptr<const Solution<3>> solution_;
  std::unique_ptr<BoundarySolver> solver_;
  RowFinisher<3> finisher_;
  BlockBuilder<3> blocks_;
  Quantum quantum_;
  RowBlock block_;
  Progress progress_;
  BindingSummary summary_;
};

}  // namespace

Result<std::unique_ptr<Binding>> create_solved_binding(std::shared_ptr<const CageIndex> index,
                                                       const CageStructures<3>& structures, QuerySet<3> queries,
                                                       const BindingSettings& settings,
                                                       const std::atomic<bool>& cancel) {
  std::unique_ptr<const Solution<3>> solution;
  std::unique_ptr<BoundarySolver> solver;
  if (settings.options.estimator == Estimator::kExact) {
    auto exact = ExactMeanValue::create(structures.cage);
    if (!exact) return exact.error();
    solution = std::move(*exact);
  } else {
    const bool moments = !structures.is_closed() || !all_inside(*structures.winding, queries.points, cancel);
    if (cancel) return Error{ErrorCode::kCancelled, "", "the request was cancelled"};
    auto created = BoundarySolver::create(
        structures.cage,
        {.panels = settings.options.panels, .sides = moments ? BoundarySides::kBoth : BoundarySides::kInside});
    if (!created) return created.error();
    solver = std::move(*created);
  }
  return std::unique_ptr<Binding>(std::make_unique<SolvedBinding>(std::move(index), structures, std::move(queries),
                                                                  settings, std::move(solution), std::move(solver)));
}

}  // namespace barycast
