#include "estimate/corrected_estimator.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>

#include "solve/moment_field.h"

namespace barycast {
namespace {

// How many times its noise must be in a correction's gradient, in squares, for any of it to count. With one, gradients
// of 12 walks on FireHydrant would be worse than without in the median (.009 for .006 of their size).
constexpr double kNoiseTimes = 2;

// Nearer to the cage than kSteepWithin gradients of corrections have walks of their own, so many that their noise,
// which grows like the reciprocal of the distance, is that of kSteepWalks there, up to kSteepWalksMost. At 0.0025 from
// the cage gradients are then off by .03 to .1 of their size, with the values' 12 walks by .11 to .2.
constexpr double kSteepWithin = 9e-3, kSteepWalks = 20;

// 0: too far from the cage.
uint32_t steep_walks(double distance) {
  if (distance >= kSteepWithin) return 0;
  const double nearness = kSteepWithin / distance;
  return static_cast<uint32_t>(
      std::min(double{CorrectedEstimator::kSteepWalksMost}, kSteepWalks * nearness * nearness));
}

// The walks' own coordinates stand in for a correction whose standard error is this part of theirs: theirs alone have
// about as much.
constexpr double kNoiseMost = 0.25;

// On the cage coordinates do not change by more over its thickness, whatever gradients say.
constexpr double kChangeMost = 0.5;

// Shrinks a gradient towards zero by what noise has a part in it [James, Stein 1961: the positive part].
void shrink(std::span<float> gradient, double noise) {
  double squared = 0.0;
  for (const float value : gradient) squared += double{value} * double{value};
  const double part = squared > 0.0 ? std::max(0.0, 1 - kNoiseTimes * noise / squared) : 0.0;
  for (float& value : gradient) value = static_cast<float>(part * double{value});
}

BoundaryData::Row row_of(const HarmonicPrediction::Rows::Table& table, Eigen::Index row) {
  return table.row(row).cast<double>();
}

}  // namespace

bool starts_outside(const Located<3>& place, const Vec<3>& origin, const WindingNumber<3>& winding) {
  return place.on_cage ? !winding.inside(origin) : (place.flags & kRowOutside) != 0;
}

CorrectedEstimator::CorrectedEstimator(const Cage<3>& cage, const DistanceIndex<3>& distance,
                                       const WindingNumber<3>& winding, const HarmonicWalks<3>& walks,
                                       const HarmonicPrediction* inside, const HarmonicPrediction* elsewhere,
                                       const BallTables* tables, const Settings& settings)
    : cage_(cage),
      locator_(cage, distance, winding, settings.thickness, settings.closed),
      walks_(walks),
      projection_(cage),
      inside_(inside),
      elsewhere_(elsewhere),
      tables_(tables),
      settings_(settings) {}

bool CorrectedEstimator::correct(std::span<const Vec<3>> points, const std::atomic<bool>& cancel, Workspace& workspace,
                                 std::span<CorrectedPoint> places, std::span<float> corrections) const {
  if (!find(points, settings_.seed, cancel, workspace, places) || !predict_moments(places, cancel, workspace))
    return false;
  for (size_t i = 0; i < points.size(); ++i) {
    if (!places[i].elsewhere) continue;
    const std::span<float> correction = row(corrections, i);
    const MomentCorrection of_moments = moment_correction(places[i], workspace.moments[i]);
    const auto outcome = correct_moments(places[i], of_moments, found(workspace, i), correction);
    const auto noisy = is_noisy(places[i], of_moments, outcome, i, correction, cancel, workspace);
    if (!noisy) return false;
    if (*noisy) take_own_coordinates(places[i], of_moments, i, workspace, correction);
  }
  if (!find_steep_gradients(cancel, workspace, places)) return false;
  for (size_t i = 0; i < points.size(); ++i) {
    if (places[i].elsewhere) continue;
    const std::span<float> correction = row(corrections, i);
    std::copy_n(found(workspace, i).begin(), row_size(), correction.begin());
    shrink(gradient(correction), workspace.noise[i]);
  }
  return true;
}

std::optional<double> CorrectedEstimator::correct_inside(const CorrectedPoint& place, const SampleQuery<3>& query,
                                                         const SampleSet<3>& samples, const std::atomic<bool>& cancel,
                                                         Workspace& workspace, std::span<float> correction) const {
  const size_t walks = samples.counts.started;
  // On the cage values follow from gradients, and do not depend on whether those were asked for.
  const bool slopes =
      settings_.gradients && !place.on_cage && walks >= FirstSteps::kWalksLeast && samples.samples.size() == walks;
  if (slopes) {
    workspace.directions.resize(walks);
    first_directions(query.random, workspace.directions);
    workspace.first_steps.start(workspace.directions, query.radius, columns());
  }
  workspace.missing.assign(columns(), 0.0);
  const auto add = [&](size_t k, std::span<const double> found) {
    for (size_t v = 0; v < columns(); ++v) workspace.missing[v] += found[v];
    if (slopes) workspace.first_steps.add(k, found);
  };
  if (!workspace.at_ends.visit(*inside_, samples.samples, cancel, add)) return std::nullopt;
  for (size_t v = 0; v < columns(); ++v)
    correction[v] = static_cast<float>(workspace.missing[v] / static_cast<double>(walks));
  return slopes ? workspace.first_steps.finish(workspace.missing, correction.subspan(columns())) : 0.0;
}

bool CorrectedEstimator::find_moments(const SampleSet<3>& samples, size_t walks, const std::atomic<bool>& cancel,
                                      Workspace& workspace, std::span<float> missing) const {
  std::vector<double>& sums = workspace.missing;
  sums.assign(static_cast<size_t>(elsewhere_->columns()), 0.0);
  const auto add = [&](size_t, std::span<const double> found) {
    for (size_t c = 0; c < found.size(); ++c) sums[c] += found[c];
  };
  if (!workspace.at_ends.visit(*elsewhere_, samples.samples, cancel, add)) return false;
  for (size_t c = 0; c < sums.size(); ++c) missing[c] = static_cast<float>(sums[c] / static_cast<double>(walks));
  return true;
}

bool CorrectedEstimator::find(std::span<const Vec<3>> points, uint64_t seed, const std::atomic<bool>& cancel,
                              Workspace& workspace, std::span<CorrectedPoint> places) const {
  // Points that tables serve wholly need no more than that they do.
  workspace.clearances.clear();
  if (tables_ != nullptr)
    for (const Vec<3>& x : points) workspace.clearances.push_back(tables_->cover().clearance(x));
  locator_.locate(points, seed, workspace.queries, places,
                  {workspace.clearances, std::max(settings_.thickness, BallTables::kOwnWalksEnd)});
  for (size_t i = 0; i < points.size(); ++i) {
    CorrectedPoint& place = places[i];
    place.origin = workspace.queries[i].origin;
    place.elsewhere = !settings_.closed || starts_outside(place, place.origin, locator_.winding());
  }
  if (!walk(places, cancel, workspace)) return false;
  workspace.noise.assign(points.size(), 0.0);
  workspace.found.assign(points.size() * found_size(), 0.0f);
  for (const size_t i : workspace.walkers) {
    const SampleSet<3>& samples = workspace.samples[i];
    if (samples.samples.empty()) places[i].flags |= kRowNoSamples;
    const std::span<float> row = found(workspace, i);
    if (places[i].elsewhere) {
      if (!find_moments(samples, places[i].counts.started, cancel, workspace, row)) return false;
      continue;
    }
    const std::optional<double> noise =
        correct_inside(places[i], workspace.queries[i], samples, cancel, workspace, row.first(row_size()));
    if (!noise) return false;
    workspace.noise[i] = *noise;
  }
  return tables_ == nullptr || blend_tables(places, cancel, workspace);
}

bool CorrectedEstimator::find_steep_gradients(const std::atomic<bool>& cancel, Workspace& workspace,
                                              std::span<CorrectedPoint> places) const {
  if (!settings_.gradients || tables_ != nullptr) return true;
  workspace.walkers.clear();
  workspace.walking.clear();
  for (size_t i = 0; i < places.size(); ++i) {
    SampleQuery<3> query = workspace.queries[i];
    query.walks = steep_walks(query.radius);
    if (places[i].elsewhere || places[i].on_cage || query.walks <= places[i].counts.started) continue;
    query.random = QueryRandom(randomized(query.random.seed(), 1), query.random.key());
    workspace.walkers.push_back(i);
    workspace.walking.push_back(query);
  }
  const std::span<SampleSet<3>> samples = std::span(workspace.samples).first(workspace.walkers.size());
  if (!walks_.sample(workspace.walking, cancel, samples)) return false;
  std::vector<float>& row = workspace.steep;
  for (size_t k = 0; k < samples.size(); ++k) {
    row.assign(row_size(), 0.0f);
    const size_t i = workspace.walkers[k];
    const auto noise = correct_inside(places[i], workspace.walking[k], samples[k], cancel, workspace, row);
    if (!noise) return false;
    workspace.noise[i] = *noise;
    std::ranges::copy(gradient(row), gradient(found(workspace, i)).begin());
  }
  return true;
}

// Samples of the points that tables do not serve wholly, each at its point's place.
bool CorrectedEstimator::walk(std::span<CorrectedPoint> places, const std::atomic<bool>& cancel,
                              Workspace& workspace) const {
  workspace.walkers.clear();
  workspace.walking.clear();
  for (size_t i = 0; i < places.size(); ++i) {
    places[i].counts = {};
    if (tables_part(places[i], workspace.queries[i].radius) >= 1) continue;
    workspace.walkers.push_back(i);
    workspace.walking.push_back(workspace.queries[i]);
  }
  if (workspace.samples.size() < places.size()) workspace.samples.resize(places.size());
  const std::span<SampleSet<3>> samples = workspace.samples;
  if (!walks_.sample(workspace.walking, cancel, samples.first(workspace.walkers.size()))) return false;
  for (size_t k = workspace.walkers.size(); k-- > 0;) {
    const size_t i = workspace.walkers[k];
    std::swap(samples[k], samples[i]);
    places[i].counts = samples[i].counts;
  }
  return true;
}

bool CorrectedEstimator::blend_tables(std::span<const CorrectedPoint> places, const std::atomic<bool>& cancel,
                                      Workspace& workspace) const {
  workspace.chosen.clear();
  workspace.points.clear();
  for (size_t i = 0; i < places.size(); ++i) {
    if (tables_part(places[i], workspace.queries[i].radius) <= 0) continue;
    workspace.chosen.push_back(i);
    workspace.points.push_back(places[i].origin);
  }
  workspace.from_tables.resize(workspace.chosen.size() * row_size());
  if (!tables_->correct(workspace.points, settings_.gradients, cancel, workspace.tables, workspace.from_tables))
    return false;
  for (size_t k = 0; k < workspace.chosen.size(); ++k) {
    const size_t i = workspace.chosen[k];
    const auto part = static_cast<float>(tables_part(places[i], workspace.queries[i].radius));
    const float* const from_tables = &workspace.from_tables[k * row_size()];
    const std::span<float> row = found(workspace, i);
    for (size_t v = 0; v < columns(); ++v)
      row[v] = part < 1 ? row[v] + part * (from_tables[v] - row[v]) : from_tables[v];
    // Those of walks so close to the cage are mostly noise.
    for (size_t j = columns(); j < row_size(); ++j) row[j] = part * from_tables[j];
    workspace.noise[i] = 0.0;
  }
  return true;
}

bool CorrectedEstimator::correct_to(double target, std::span<const Vec<3>> points, const std::atomic<bool>& cancel,
                                    Workspace& workspace, std::span<CorrectedPoint> places,
                                    std::span<float> corrections, std::span<Randomizations::Error> errors) const {
  std::vector<size_t>& open = workspace.open;
  open.resize(points.size());
  std::iota(open.begin(), open.end(), size_t{0});
  if (workspace.randomizations.size() < points.size()) workspace.randomizations.resize(points.size());
  std::fill(corrections.begin(), corrections.end(), 0.0f);
  workspace.summed_noise.assign(points.size(), 0.0);
  size_t look = kRoundsLeast;
  for (size_t round = 0; !open.empty(); ++round) {
    workspace.open_points.clear();
    for (const size_t i : open) workspace.open_points.push_back(points[i]);
    workspace.open_places.resize(open.size());
    if (!find(workspace.open_points, randomized(settings_.seed, round), cancel, workspace, workspace.open_places))
      return false;
    for (size_t k = 0; k < open.size(); ++k) {
      const size_t i = open[k];
      const SampleCounts before = round == 0 ? SampleCounts{} : places[i].counts;
      places[i] = workspace.open_places[k];
      places[i].counts += before;
      const size_t size = places[i].elsewhere ? static_cast<size_t>(elsewhere_->columns()) : columns();
      if (round == 0) workspace.randomizations[i].clear(size);
      const std::span<float> found = this->found(workspace, k);
      workspace.randomizations[i].add(found.first(size));
      if (places[i].elsewhere) continue;
      const std::span<float> sum = gradient(row(corrections, i)), slopes = gradient(found);
      for (size_t v = 0; v < sum.size(); ++v) sum[v] += slopes[v];
      workspace.summed_noise[i] += workspace.noise[k];
    }
    if (round == 0 && !predict_moments(places, cancel, workspace)) return false;
    if (round + 1 < look) continue;
    std::erase_if(open, [&](size_t i) {
      errors[i] = error(places[i], workspace.moments[i], workspace.randomizations[i]);
      if (errors[i].standard > target && look < kRoundsMost) return false;
      take_mean(workspace.randomizations[i], workspace.moments[i], workspace.summed_noise[i], places[i],
                row(corrections, i));
      return true;
    });
    look *= 2;
  }
  return true;
}

Randomizations::Error CorrectedEstimator::error(const CorrectedPoint& place, const BoundaryData::Row& moments,
                                                const Randomizations& found) const {
  // On the cage values are the basis' own, without noise.
  if (place.on_cage) return {};
  return place.elsewhere ? moment_correction(place, moments).error(found) : found.error();
}

void CorrectedEstimator::take_mean(const Randomizations& found, const BoundaryData::Row& moments, double summed_noise,
                                   CorrectedPoint& place, std::span<float> correction) const {
  if (place.elsewhere) {
    std::vector<float> missing(static_cast<size_t>(moments.size()));
    found.mean(missing);
    correct_moments(place, moment_correction(place, moments), missing, correction);
    return;
  }
  found.mean(correction.first(columns()));
  const auto rounds = static_cast<double>(found.count());
  const std::span<float> sum = gradient(correction);
  for (float& value : sum) value = static_cast<float>(double{value} / rounds);
  shrink(sum, summed_noise / (rounds * rounds));
}

bool CorrectedEstimator::predict(std::span<const CorrectedPoint> places, bool elsewhere, bool gradients,
                                 const std::atomic<bool>& cancel, Workspace& workspace) const {
  workspace.points.clear();
  for (const size_t i : workspace.chosen) workspace.points.push_back(places[i].origin);
  return workspace.chosen.empty() ||
         prediction(elsewhere).evaluate(workspace.points, gradients, cancel, workspace.rows);
}

bool CorrectedEstimator::predict_moments(std::span<const CorrectedPoint> places, const std::atomic<bool>& cancel,
                                         Workspace& workspace) const {
  workspace.chosen.clear();
  for (size_t i = 0; i < places.size(); ++i)
    if (places[i].elsewhere) workspace.chosen.push_back(i);
  workspace.moments.resize(places.size());
  if (!predict(places, true, false, cancel, workspace)) return false;
  for (size_t k = 0; k < workspace.chosen.size(); ++k)
    workspace.moments[workspace.chosen[k]] = row_of(workspace.rows.values, static_cast<Eigen::Index>(k));
  return true;
}

MomentCorrection::Outcome CorrectedEstimator::correct_moments(CorrectedPoint& place, const MomentCorrection& of_moments,
                                                              std::span<const float> missing,
                                                              std::span<float> correction) const {
  const auto outcome = of_moments.correct(missing, correction.first(columns()));
  if (outcome != MomentCorrection::Outcome::kCorrected && !of_moments.predicted_spans())
    place.flags |= kRowRankDeficient;
  const std::span<float> slopes = gradient(correction);
  std::fill(slopes.begin(), slopes.end(), 0.0f);
  return outcome;
}

std::optional<bool> CorrectedEstimator::is_noisy(const CorrectedPoint& place, const MomentCorrection& of_moments,
                                                 MomentCorrection::Outcome outcome, size_t i,
                                                 std::span<const float> correction, const std::atomic<bool>& cancel,
                                                 Workspace& workspace) const {
  const std::vector<Sample<3>>& samples = workspace.samples[i].samples;
  if (place.on_cage || samples.size() < 2 || outcome == MomentCorrection::Outcome::kLittleMass) return false;
  if (outcome == MomentCorrection::Outcome::kSingular) return true;
  if (!of_moments.is_large(correction.first(columns()))) return false;
  const BoundaryData::Row own = own_coordinates(place, i, workspace);
  const Eigen::Map<const Eigen::RowVectorXf> change(correction.data(), own.size());
  // Walks that all went one way do not show the noise that they have.
  if ((of_moments.predicted_values() + change.cast<double>() - own).norm() > own.norm()) return true;
  // A power of two of the walks says how much noise all have.
  const size_t some = std::bit_floor(samples.size());
  std::vector<float> of_walk(static_cast<size_t>(elsewhere_->columns()));
  workspace.by_walk.clear(of_walk.size());
  const auto add = [&](size_t, std::span<const double> found) {
    std::transform(found.begin(), found.end(), of_walk.begin(), [](double value) { return static_cast<float>(value); });
    workspace.by_walk.add(of_walk);
  };
  if (!workspace.at_ends.visit(*elsewhere_, std::span(samples).first(some), cancel, add)) return std::nullopt;
  const double noise = of_moments.error(workspace.by_walk).standard *
                       std::sqrt(static_cast<double>(some) / static_cast<double>(place.counts.started));
  return noise > kNoiseMost * own.norm();
}

BoundaryData::Row CorrectedEstimator::own_coordinates(const CorrectedPoint& place, size_t i,
                                                      Workspace& workspace) const {
  if (!workspace.accumulator) workspace.accumulator.emplace(cage_);
  workspace.accumulator->accumulate(workspace.samples[i].samples, Weights::kAsGiven, workspace.own_moments);
  projection_.project(workspace.own_moments, PseudoSamples::kAlways, workspace.projected);
  const Vec<4> at = homogeneous<3>(place.origin);
  const Eigen::RowVector4d pseudo = at.transpose() * workspace.projected.pseudo;
  BoundaryData::Row own(static_cast<Eigen::Index>(columns()));
  auto fit = workspace.projected.fits.begin();
  for (size_t v = 0; v < columns(); ++v) {
    const uint32_t vertex = cage_.used_vertices()[v];
    double value = pseudo * homogeneous<3>(cage_.control_vertices()[vertex]);
    if (fit != workspace.projected.fits.end() && fit->vertex == vertex) value += at.dot((fit++)->u);
    own[static_cast<Eigen::Index>(v)] = value;
  }
  return own;
}

void CorrectedEstimator::take_own_coordinates(CorrectedPoint& place, const MomentCorrection& of_moments, size_t i,
                                              Workspace& workspace, std::span<float> correction) const {
  place.flags |= kRowRankDeficient;
  const BoundaryData::Row change = own_coordinates(place, i, workspace) - of_moments.predicted_values();
  Eigen::Map<Eigen::RowVectorXf>(correction.data(), change.size()) = change.cast<float>();
}

// From moments and their gradients to coordinates and theirs.
void CorrectedEstimator::project(const Vec<3>& origin, Rows& rows) const {
  const Rows moments = rows;
  rows.values.resize(static_cast<Eigen::Index>(columns()));
  project_moments(elsewhere_->data(), origin, moments.values, moments.gradients, rows.values, rows.gradients);
}

// To the row of x from what is predicted where its samples start.
void CorrectedEstimator::finish(const Vec<3>& x, const CorrectedPoint& place, std::span<const float> correction,
                                Rows& rows) const {
  if (place.elsewhere) project(place.origin, rows);
  if (!place.on_cage) {
    const auto n = static_cast<Eigen::Index>(columns());
    const auto part = [&](size_t k) {
      return Eigen::Map<const Eigen::RowVectorXf>(&correction[k * columns()], n).cast<double>();
    };
    rows.values += part(0);
    for (size_t a = 0; settings_.gradients && a < 3; ++a) rows.gradients[a] += part(1 + a);
    return;
  }
  const CagePoint<3>& y = *place.on_cage;
  prediction(place.elsewhere).data().values(y.element, y.shares, y.point, rows.values);
  BoundaryData::Row change = BoundaryData::Row::Zero(rows.values.size());
  for (size_t k = 0; k < 3; ++k) {
    const auto axis = static_cast<Eigen::Index>(k);
    change += (x[axis] - y.point[axis]) * rows.gradients[k];
  }
  if (change.norm() < kChangeMost) rows.values += change;
}

bool CorrectedEstimator::evaluate(std::span<const Vec<3>> points, std::span<const CorrectedPoint> places,
                                  std::span<const float> corrections, const std::atomic<bool>& cancel,
                                  Workspace& workspace, const std::function<void(size_t, const Rows&)>& row) const {
  Rows rows;
  for (const bool elsewhere : {false, true})
    for (const bool sloped : {false, true}) {
      // Inside all together, as is cheapest there. Elsewhere there are four times as many columns.
      const size_t most = elsewhere ? kElsewhereTogether : points.size();
      for (size_t next = 0; next < points.size();) {
        workspace.chosen.clear();
        for (; next < points.size() && workspace.chosen.size() < most; ++next)
          if (places[next].elsewhere == elsewhere && (settings_.gradients || places[next].on_cage) == sloped)
            workspace.chosen.push_back(next);
        if (!predict(places, elsewhere, sloped, cancel, workspace)) return false;
        for (BoundaryData::Row& partial : rows.gradients) partial.resize(0);
        for (size_t k = 0; k < workspace.chosen.size(); ++k) {
          const size_t i = workspace.chosen[k];
          const auto at = static_cast<Eigen::Index>(k);
          rows.values = row_of(workspace.rows.values, at);
          for (size_t a = 0; sloped && a < 3; ++a) rows.gradients[a] = row_of(workspace.rows.gradients[a], at);
          finish(points[i], places[i], corrections.subspan(i * row_size(), row_size()), rows);
          row(i, rows);
        }
      }
    }
  return true;
}

}  // namespace barycast
