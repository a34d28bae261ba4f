#include "solve/local_expansions.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numeric>

namespace barycast {
namespace {

// A panel is far from a cell where all of it is at least this many times as far from the middle as the cell's corners.
// FireHydrant's cage, rows off by: 3e-5 with 1.3, 1e-5 with 1.7, 5e-6 with 2, at 2.0, 2.2, 2.6 us.
constexpr double kFar = 1.7;
// Of a column, over its panels, of charge by radius: what potentials there may be. Cages of character models have at
// most 1, where floats begin to lose digits it is 3 to 7, in a box of 2 x 2 x .002 4,500.
constexpr double kPotentialMost = 2.0;

constexpr size_t kFitPoints = kSumPoints;  // a batch, a third more than there are terms
constexpr auto kTerms = static_cast<Eigen::Index>(kSumTerms);

// Points all over the unit sphere, a golden angle after each other.
std::array<Vec<3>, kFitPoints> sphere_points() {
  constexpr double kCosine = -0.73736887807831963, kSine = 0.67549029426152362;
  std::array<Vec<3>, kFitPoints> points;
  double x = 1.0, y = 0.0;
  for (size_t i = 0; i < kFitPoints; ++i) {
    const double z = 1 - (2 * static_cast<double>(i) + 1) / kFitPoints, radius = std::sqrt(1 - z * z);
    points[i] = {radius * x, radius * y, z};
    const double turned = kCosine * x - kSine * y;
    y = kSine * x + kCosine * y;
    x = turned;
  }
  return points;
}

// From values at those points to coefficients, by least squares.
struct Fit {
  std::array<Vec<3>, kFitPoints> points = sphere_points();
  std::array<std::array<float, kFitPoints>, kSumTerms> factors;

  Fit() {
    const Eigen::MatrixXd terms = terms_at_points();
    // Terms differ in size by millions.
    const Eigen::VectorXd scale = terms.colwise().norm().cwiseInverse();
    const Eigen::MatrixXd scaled = terms * scale.asDiagonal();
    // Products and solutions whose order of sums does not follow the processor's caches.
    const Eigen::LDLT<Eigen::MatrixXd> gram(scaled.transpose().lazyProduct(scaled));
    for (size_t i = 0; i < kFitPoints; ++i) {
      const Eigen::VectorXd at_point = scaled.row(static_cast<Eigen::Index>(i)).transpose();
      const Eigen::VectorXd factor = scale.cwiseProduct(gram.solve(at_point));
      for (size_t t = 0; t < kSumTerms; ++t) factors[t][i] = static_cast<float>(factor[static_cast<Eigen::Index>(t)]);
    }
  }

  static const Fit& get() {
    static const Fit fit;
    return fit;
  }

 private:
  // As the sums have them: what an expansion without coefficients leaves behind.
  Eigen::MatrixXd terms_at_points() const {
    const SumLine no_coefficients{};
    const std::array<float, kSumTerms> not_enclosed{};
    const SumExpansion unit_ball{.centre = {},
                                 .inverse_radius = 1.0f,
                                 .coefficients = no_coefficients.lane.data(),
                                 .stride = 0,
                                 .enclosed = not_enclosed.data()};
    std::vector<SumLine> memory((3 + kSumRows + kSumLanes + 1) * kSumPoints / kSumLanes);
    float* const x = memory[0].lane.data();
    SumBatch batch{};
    batch.points = batch.lanes = kSumPoints;
    batch.x = {x, x + kSumPoints, x + 2 * kSumPoints};
    batch.kernels = x + 3 * kSumPoints;
    batch.sums = batch.kernels + kSumRows * kSumPoints;
    batch.enclosed = batch.sums + kSumLanes * kSumPoints;
    Eigen::MatrixXd terms(kFitPoints, kTerms);
    for (size_t i = 0; i < kFitPoints; ++i)
      for (size_t k = 0; k < 3; ++k)
        x[k * kSumPoints + i] = static_cast<float>(points[i][static_cast<Eigen::Index>(k)]);
    add_expansion(unit_ball, false, kSumLanes, batch);
    for (size_t i = 0; i < kFitPoints; ++i)
      for (size_t t = 0; t < kSumTerms; ++t)
        terms(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(t)) = double{batch.kernels[t * kSumPoints + i]};
    return terms;
  }
};

// Of a cell, about.
size_t cell_bytes(size_t columns) {
  constexpr size_t kRest = 1200;
  return kSumTerms * sum_lines(columns) * sizeof(SumLine) + kRest;
}

}  // namespace

struct LocalExpansions::Cell {
  Vec<3> middle;
  double reach;                // of its corners, from the middle
  std::vector<uint32_t> near;  // panels
  // Of all others.
  std::vector<SumLine> coefficients;
  std::array<float, kSumTerms> enclosed{};
  SumExpansion expansion{};

  // Along an axis the cells of a grid are numbered from its low end.
  Cell(const std::array<uint32_t, 3>& at, size_t cells_of_edge)
      : reach(std::sqrt(3.0) / 2 / static_cast<double>(cells_of_edge)) {
    for (size_t k = 0; k < 3; ++k)
      middle[static_cast<Eigen::Index>(k)] = (at[k] + 0.5) / static_cast<double>(cells_of_edge) - 0.5;
  }
  Cell(const Cell&) = delete;
  Cell& operator=(const Cell&) = delete;

  bool is_far(const Panel& panel) const { return (panel.centre - middle).norm() - panel.radius >= kFar * reach; }
  size_t held() const { return near.size() * sizeof(uint32_t) + coefficients.size() * sizeof(SumLine); }
  size_t bytes() const { return sizeof(*this) + held(); }
};

struct LocalExpansions::CoarseCell : Cell {
  explicit CoarseCell(uint32_t number) : Cell(place(number), kCoarse) {}
  static std::array<uint32_t, 3> place(uint32_t number) {
    return {number % kCoarse, number / kCoarse % kCoarse, number / kCoarse / kCoarse};
  }
  std::array<PublishOnce<Cell>, kChildren> fine;
  size_t bytes() const { return sizeof(*this) + held(); }
};

LocalExpansions::LocalExpansions(const PanelSums& sums, const Panels& panels, size_t bytes_max)
    : sums_(sums),
      panels_(panels),
      uses_(kCoarse * kCoarse * kCoarse, Use::kNone),
      coarse_(uses_.size()),
      bytes_(sizeof(*this) + uses_.size() * (sizeof(Use) + sizeof(coarse_[0]))) {
  choose_uses(bytes_max);
}

LocalExpansions::~LocalExpansions() = default;

void LocalExpansions::choose_uses(size_t bytes_max) {
  Eigen::Array3d low = Eigen::Array3d::Constant(1.0), high = -low;
  for (const Panel& panel : panels_.panels)
    for (const Vec<3>& corner : panel.corner) {
      low = low.min(corner.array());
      high = high.max(corner.array());
    }
  struct Candidate {
    size_t near;
    uint32_t number;
  };
  std::vector<Candidate> candidates;
  for (uint32_t number = 0; number < uses_.size(); ++number) {
    const CoarseCell cell(number);
    const double half = 0.5 / kCoarse;
    if ((cell.middle.array() + half < low).any() || (cell.middle.array() - half > high).any()) continue;
    const auto near = std::count_if(panels_.panels.begin(), panels_.panels.end(),
                                    [&](const Panel& panel) { return !cell.is_far(panel); });
    candidates.push_back({static_cast<size_t>(near), number});
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.near > b.near; });
  const size_t of_cell = cell_bytes(static_cast<size_t>(sums_.column_count())), cells = bytes_max / of_cell;
  size_t used = 0;
  for (const auto& [near, number] : candidates) {
    if (used == cells) break;
    uses_[number] = Use::kWhole;
    ++used;
  }
  for (const auto& [near, number] : candidates) {
    if (used + kChildren > cells) break;
    uses_[number] = Use::kDivided;
    used += kChildren;
  }
}

bool LocalExpansions::hold(const PanelSums& sums, const Panels& panels) {
  for (size_t column = 0; column < static_cast<size_t>(sums.column_count()); ++column) {
    double potential = 0.0;
    for (size_t p = 0; p < panels.panels.size(); ++p) potential += sums.charge(p, column) / panels.panels[p].radius;
    if (!(potential <= kPotentialMost)) return false;
  }
  return true;
}

uint32_t LocalExpansions::name_of(const Vec<3>& x) const {
  uint32_t number = 0, child = 0;
  for (Eigen::Index k = 3; k-- > 0;) {
    const double at = std::floor((x[k] + 0.5) * (2 * kCoarse));
    if (!(at >= 0 && at < 2 * kCoarse)) return kOutside;
    const auto fine = static_cast<uint32_t>(at);
    number = number * kCoarse + fine / 2;
    child = child * 2 + fine % 2;
  }
  if (uses_[number] == Use::kNone) return kOutside;
  return number * (kChildren + 1) + (uses_[number] == Use::kDivided ? child : kWhole);
}

// Those of the candidates that are far, and what others add up to, as an expansion; the rest stays near.
void LocalExpansions::expand(std::span<const uint32_t> candidates, const SumExpansion* others, Cell& cell) const {
  std::vector<uint32_t> far;
  for (const uint32_t p : candidates) (cell.is_far(panels_.panels[p]) ? far : cell.near).push_back(p);
  const Fit& fit = Fit::get();
  std::array<Vec<3>, kFitPoints> points;
  std::array<size_t, kFitPoints> rows;
  for (size_t i = 0; i < kFitPoints; ++i) points[i] = cell.middle + cell.reach * fit.points[i];
  std::iota(rows.begin(), rows.end(), size_t{0});
  PanelSums::Rows sums;
  PanelSums::Evaluator(sums_, kFitPoints, sums_.column_count(), false, sums).fill({far, others}, points, rows);

  const auto columns = static_cast<size_t>(sums_.column_count());
  const size_t lines = sum_lines(columns);
  cell.coefficients.resize(kSumTerms * lines);
  for (size_t t = 0; t < kSumTerms; ++t) {
    float* __restrict const row = cell.coefficients[t * lines].lane.data();
    for (size_t i = 0; i < kFitPoints; ++i) {
      const float factor = fit.factors[t][i];
      const float* __restrict const values = sums.values.row(static_cast<Eigen::Index>(i)).data();
      for (size_t v = 0; v < columns; ++v) row[v] += factor * values[v];
      if (!sums.enclosed.empty()) cell.enclosed[t] += factor * sums.enclosed[i];
    }
  }
  const Eigen::Vector3f centre = cell.middle.cast<float>();
  cell.expansion = {.centre = {centre[0], centre[1], centre[2]},
                    .inverse_radius = static_cast<float>(1 / cell.reach),
                    .coefficients = cell.coefficients[0].lane.data(),
                    .stride = lines * kSumLanes,
                    .enclosed = cell.enclosed.data()};
}

template <class T>
const T& LocalExpansions::keep(std::unique_ptr<const T> made, const PublishOnce<T>& place) const {
  const size_t bytes = made->bytes();
  if (place.publish(made)) bytes_.fetch_add(bytes, std::memory_order_relaxed);
  return *place.get();
}

const LocalExpansions::CoarseCell& LocalExpansions::coarse_cell(uint32_t number) const {
  const PublishOnce<CoarseCell>& place = coarse_[number];
  if (const CoarseCell* const there = place.get(); there != nullptr) return *there;
  auto cell = std::make_unique<CoarseCell>(number);
  expand(sums_.all_panels(), nullptr, *cell);
  return keep<CoarseCell>(std::move(cell), place);
}

const LocalExpansions::Cell& LocalExpansions::cell(uint32_t name) const {
  const uint32_t number = name / (kChildren + 1), child = name % (kChildren + 1);
  const CoarseCell& coarse = coarse_cell(number);
  if (child == kWhole) return coarse;
  const PublishOnce<Cell>& place = coarse.fine[child];
  if (const Cell* const there = place.get(); there != nullptr) return *there;
  std::array<uint32_t, 3> at = CoarseCell::place(number);
  for (size_t k = 0; k < 3; ++k) at[k] = 2 * at[k] + (child >> k & 1);
  auto cell = std::make_unique<Cell>(at, 2 * kCoarse);
  expand(coarse.near, &coarse.expansion, *cell);
  return keep<Cell>(std::move(cell), place);
}

bool LocalExpansions::evaluate(std::span<const Vec<3>> points, bool gradients, const std::atomic<bool>& cancel,
                               PanelSums::Rows& out) const {
  // Points of a cell follow each other.
  std::vector<std::pair<uint32_t, size_t>> order;
  order.reserve(points.size());
  for (size_t i = 0; i < points.size(); ++i) order.emplace_back(name_of(points[i]), i);
  std::sort(order.begin(), order.end());
  PanelSums::Evaluator evaluator(sums_, points.size(), sums_.column_count(), gradients, out);
  std::vector<Vec<3>> some;
  std::vector<size_t> rows;
  for (size_t i = 0; i < order.size();) {
    if (cancel.load(std::memory_order_relaxed)) return false;
    const uint32_t name = order[i].first;
    some.clear();
    rows.clear();
    for (; i < order.size() && order[i].first == name && rows.size() < kSumPoints; ++i) {
      rows.push_back(order[i].second);
      some.push_back(points[order[i].second]);
    }
    PanelSums::Part part{.panels = sums_.all_panels()};
    if (name != kOutside) {
      const Cell& of_points = cell(name);
      part = {of_points.near, &of_points.expansion};
    }
    evaluator.fill(part, some, rows);
  }
  return true;
}

// Cages have a box whose diagonal is 1: at most a cube of edge 1 / sqrt(3), in which a surface passes through some 320
// fine cells.
size_t LocalExpansions::expected_bytes(size_t points, size_t columns) {
  constexpr double kCells = 320;
  const double cells = kCells * (1 - std::exp(-static_cast<double>(points) / kCells));
  return std::min(kBytesMax, static_cast<size_t>(1.3 * cells) * cell_bytes(columns));
}

size_t LocalExpansions::most_bytes(size_t points, size_t columns) {
  // Of edges 12 : 10 : 10, and of a cube.
  constexpr size_t kFineMost = 12 * 10 * 10, kCoarseMost = 6 * 6 * 6;
  return std::min(kBytesMax, (std::min(points, kFineMost) + std::min(points, kCoarseMost)) * cell_bytes(columns));
}

}  // namespace barycast
