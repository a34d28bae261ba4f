#include "estimate/ball_tables.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "base/parallel.h"
#include "base/tolerances.h"

namespace barycast {
namespace {

// Of the tables' walks: a constant, for tables depend on the cage alone.
constexpr uint64_t kSeed = 0xBA11;
constexpr uint32_t kStepsMax = 300;
// Balls whose walks advance together: enough to keep vectors full to the last walks.
constexpr size_t kBallsPerTask = 8;

// out[part][v] += sum_j factors[part][j] rows[j][v]
template <size_t kParts>
void add_rows(const std::array<HarmonicValues, kParts>& factors, const int16_t* __restrict rows, size_t width,
              float* __restrict out) {
  for (size_t v = 0; v < width; ++v) {
    float coefficient[kHarmonics];
    for (size_t j = 0; j < kHarmonics; ++j) coefficient[j] = static_cast<float>(rows[j * width + v]);
    for (size_t part = 0; part < kParts; ++part) {
      float sum = out[part * width + v];
      for (size_t j = 0; j < kHarmonics; ++j) sum += factors[part][j] * coefficient[j];
      out[part * width + v] = sum;
    }
  }
}

// One leaf's part of a point's row, and with gradients of its partial derivatives.
template <bool kGradients>
void add_table(const BallLeaf& leaf, const BallTable& table, const Vec<3>& x, float weight, size_t width, float* rows) {
  std::array<HarmonicValues, kGradients ? 4 : 1> factors;
  const auto set = [&](size_t part, const HarmonicValues& harmonics, float scale) {
    for (size_t j = 0; j < kHarmonics; ++j) factors[part][j] = harmonics[j] * scale * table.step[j];
  };
  const Vec<3> at = (x - leaf.centre) / leaf.radius;
  set(0, solid_harmonics(at), weight);
  if constexpr (kGradients) {
    const std::array<HarmonicValues, 3> partials = solid_harmonic_gradients(at);
    for (size_t a = 0; a < 3; ++a) set(1 + a, partials[a], weight / static_cast<float>(leaf.radius));
  }
  add_rows(factors, table.coefficients.data(), width, rows);
}

// In half the memory of floats.
void quantize(const std::vector<float>& coefficients, size_t width, BallTable& table) {
  constexpr float kMost = 32767;
  table.coefficients.resize(coefficients.size());
  for (size_t j = 0; j < kHarmonics; ++j) {
    const float* const row = &coefficients[j * width];
    float largest = 0.0f;
    for (size_t v = 0; v < width; ++v) largest = std::max(largest, std::abs(row[v]));
    table.step[j] = largest / kMost;
    const float steps = largest > 1e-30f ? kMost / largest : 0.0f;
    for (size_t v = 0; v < width; ++v)
      table.coefficients[j * width + v] = static_cast<int16_t>(std::nearbyint(row[v] * steps));
  }
}

}  // namespace

BallTables::BallTables(const Cage<3>& cage, const DistanceIndex<3>& distance, const WindingNumber<3>& winding,
                       const HarmonicPrediction& inside, const BallTableSettings& settings)
    : inside_(inside),
      cover_(distance, winding),
      walks_(distance, {.walks = settings.walks, .thickness = kThicknessDefault, .walk_steps_max = kStepsMax}),
      settings_(settings),
      columns_(cage.used_vertices().size()) {}

double BallTables::part(double distance) {
  return smooth_step((distance - BallCover::kDistanceMin) / (kOwnWalksEnd - BallCover::kDistanceMin));
}

bool BallTables::fill(const SampleQuery<3>& query, const SampleSet<3>& samples, const std::atomic<bool>& cancel,
                      Workspace& workspace, BallTable& table) const {
  BARYCAST_CHECK_OP(samples.samples.size(), ==, size_t{settings_.walks});
  std::vector<Vec<3>> directions(settings_.walks);
  first_directions(query.random, directions);
  const std::vector<HarmonicValues> factors = harmonic_projection(directions);
  const size_t width = this->width();
  workspace.coefficients.assign(kHarmonics * width, 0.0f);
  workspace.row.assign(width, 0.0f);
  const auto add = [&](size_t i, std::span<const double> missing) {
    for (size_t v = 0; v < columns_; ++v) workspace.row[v] = static_cast<float>(missing[v]);
    const float* __restrict const row = workspace.row.data();
    for (size_t j = 0; j < kHarmonics; ++j) {
      float* __restrict const sum = &workspace.coefficients[j * width];
      const float factor = factors[i][j];
      for (size_t v = 0; v < width; ++v) sum[v] += factor * row[v];
    }
  };
  if (!workspace.at_ends.visit(inside_, samples.samples, cancel, add)) return false;
  quantize(workspace.coefficients, width, table);
  return true;
}

void BallTables::keep(const BallLeaf& leaf, BallTable& table) const {
  const size_t bytes = table_bytes_each();
  if (table_bytes_.fetch_add(bytes, std::memory_order_relaxed) + bytes <= settings_.bytes_max) {
    std::unique_ptr<const BallTable> value = std::make_unique<const BallTable>(table);
    if (leaf.table.publish(value)) {
      tables_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
  }
  table_bytes_.fetch_sub(bytes, std::memory_order_relaxed);
}

// Leaves a table in the workspace for each of the leaves, and keeps it if it can.
bool BallTables::make(std::span<const BallLeaf* const> leaves, const std::atomic<bool>& cancel,
                      Workspace& workspace) const {
  if (workspace.tables.size() < leaves.size()) workspace.tables.resize(leaves.size());
  workspace.samples.resize(kBallsPerTask);
  for (size_t first = 0; first < leaves.size(); first += kBallsPerTask) {
    const std::span<const BallLeaf* const> some = leaves.subspan(first, std::min(kBallsPerTask, leaves.size() - first));
    workspace.queries.clear();
    for (const BallLeaf* leaf : some)
      workspace.queries.push_back({leaf->centre, leaf->radius, QueryRandom(kSeed, leaf->name)});
    if (!walks_.sample(workspace.queries, cancel, std::span(workspace.samples).first(some.size()))) return false;
    for (size_t i = 0; i < some.size(); ++i) {
      if (!fill(workspace.queries[i], workspace.samples[i], cancel, workspace, workspace.tables[first + i]))
        return false;
      keep(*some[i], workspace.tables[first + i]);
    }
  }
  return true;
}

bool BallTables::correct(std::span<const Vec<3>> points, bool gradients, const std::atomic<bool>& cancel,
                         Workspace& workspace, std::span<float> corrections) const {
  std::vector<Workspace::Use>& uses = workspace.uses;
  uses.clear();
  workspace.wanted.clear();
  for (size_t i = 0; i < points.size(); ++i) {
    const size_t begin = uses.size();
    float sum = 0.0f;
    cover_.for_each(points[i], [&](const BallLeaf& leaf, double weight) {
      uses.push_back({&leaf, i, static_cast<float>(weight)});
      sum += uses.back().weight;
      if (leaf.table.get() == nullptr) workspace.wanted.push_back(&leaf);
    });
    for (size_t k = begin; k < uses.size(); ++k) uses[k].weight /= sum;
  }
  // In the order of their names, not of their addresses: neighbours in space walk together.
  std::vector<const BallLeaf*>& wanted = workspace.wanted;
  std::sort(wanted.begin(), wanted.end(), [](const BallLeaf* a, const BallLeaf* b) { return a->name < b->name; });
  wanted.erase(std::unique(wanted.begin(), wanted.end()), wanted.end());
  if (!wanted.empty() && !make(wanted, cancel, workspace)) return false;

  const size_t width = this->width(), parts = gradients ? 4 : 1;
  std::vector<float>& rows = workspace.row;
  size_t k = 0;
  for (size_t i = 0; i < points.size(); ++i) {
    rows.assign(parts * width, 0.0f);
    for (; k < uses.size() && uses[k].point == i; ++k) {
      const auto& [leaf, point, weight] = uses[k];
      const BallTable* table = leaf->table.get();
      if (table == nullptr) {
        const auto at = std::lower_bound(wanted.begin(), wanted.end(), leaf,
                                         [](const BallLeaf* a, const BallLeaf* b) { return a->name < b->name; });
        table = &workspace.tables[static_cast<size_t>(at - wanted.begin())];
      }
      if (gradients)
        add_table<true>(*leaf, *table, points[i], weight, width, rows.data());
      else
        add_table<false>(*leaf, *table, points[i], weight, width, rows.data());
    }
    for (size_t part = 0; part < parts; ++part)
      std::copy_n(&rows[part * width], columns_, &corrections[(i * parts + part) * columns_]);
  }
  return true;
}

std::vector<const BallLeaf*> BallTables::missing(size_t tables_max, const std::atomic<bool>& cancel) const {
  // No more than may be kept, and those that are there.
  const size_t room = settings_.bytes_max / table_bytes_each();
  std::vector<const BallLeaf*> leaves =
      cover_.leaves(std::min(room, std::min(room, tables_max) + table_count()), cancel);
  std::erase_if(leaves, [](const BallLeaf* leaf) { return leaf->table.get() != nullptr; });
  leaves.resize(std::min(leaves.size(), tables_max));
  return leaves;
}

size_t BallTables::build(std::span<const BallLeaf* const> leaves, const std::atomic<bool>& cancel) const {
  std::atomic<size_t> built = 0;
  std::atomic<bool> full = false;
  parallel_build(leaves.size(), kBallsPerTask, [&](size_t begin, size_t end) {
    if (full.load(std::memory_order_relaxed)) return;
    Workspace workspace;
    if (!make(leaves.subspan(begin, end - begin), cancel, workspace)) return;
    for (size_t i = begin; i < end; ++i) {
      if (leaves[i]->table.get() == nullptr)
        full = true;
      else
        ++built;
    }
  });
  return built;
}

}  // namespace barycast
