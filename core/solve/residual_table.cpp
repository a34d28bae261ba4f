#include "solve/residual_table.h"

#include <algorithm>
#include <cmath>

#include "base/parallel.h"

namespace barycast {
namespace {

constexpr double kStepsLeast = 4, kStepsMost = 64;
// How far nodes stay from the border of their element, in its parameters.
constexpr double kInset = 1e-4;

// Shares of corners at parameters of an element: those of a quad's patch; a triangle is a quad whose side u = 0 is its
// first corner, so that linear functions are bilinear.
std::array<double, 4> shares_at(bool quad, double u, double v) {
  if (quad) return {(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v};
  return {1 - u, u * (1 - v), u * v, 0.0};
}

// Of the lattice of an element, along either parameter.
size_t steps_of(size_t elements, size_t nodes) {
  const double of_element = static_cast<double>(nodes) / static_cast<double>(elements);
  return static_cast<size_t>(std::clamp(std::sqrt(of_element) - 1, kStepsLeast, kStepsMost));
}

}  // namespace

size_t ResidualTable::node_count(size_t elements, size_t nodes) {
  const size_t side = steps_of(elements, nodes) + 1;
  return elements * side * side;
}

ResidualTable::ResidualTable(const Cage<3>& cage, size_t columns, size_t nodes) : cage_(cage), columns_(columns) {
  const size_t steps = steps_of(cage.elements().size(), nodes);
  for (size_t i = 0; i <= steps; ++i) {
    // Steps shrink in proportion to the distance from the border, as those of panels do.
    const double s = static_cast<double>(i) / static_cast<double>(steps);
    position_.push_back(s * s / (s * s + (1 - s) * (1 - s)));
  }
  rows_.assign(node_count() * columns_, 0.0f);
}

ResidualTable::Node ResidualTable::node(size_t i) const {
  const size_t side = position_.size();
  const auto element = static_cast<uint32_t>(i / nodes_of_element());
  const auto at = [&](size_t k) { return kInset + (1 - 2 * kInset) * position_[k]; };
  return {element, shares_at(is_quad(element), at(i % side), at(i / side % side))};
}

ResidualTable::Cell ResidualTable::cell(double t) const {
  const size_t last = position_.size() - 2;
  // Next to a triangle's first corner rounding may make any ratio of its shares.
  t = std::clamp(t, 0.0, 1.0);
  const double root = std::sqrt(t), rest = std::sqrt(1 - t);
  size_t first = std::min(last, static_cast<size_t>(root / (root + rest) * static_cast<double>(last + 1)));
  // Rounding may find the cell beside it.
  if (first > 0 && t < position_[first]) --first;
  return {first, (t - position_[first]) / (position_[first + 1] - position_[first])};
}

ResidualTable::Node ResidualTable::inset(uint32_t element, const std::array<double, 4>& shares) const {
  const auto [u, v] = parameters(element, shares);
  const auto inside = [](double t) { return std::clamp(t, kInset, 1 - kInset); };
  return {element, shares_at(is_quad(element), inside(u), inside(v))};
}

std::array<double, 2> ResidualTable::parameters(uint32_t element, const std::array<double, 4>& shares) const {
  const double u = shares[1] + shares[2];
  if (is_quad(element)) return {u, shares[2] + shares[3]};
  return {u, u > 0 ? shares[2] / u : 0.0};  // a triangle's first corner has any v
}

std::array<ResidualTable::Cell, 2> ResidualTable::cells(uint32_t element, const std::array<double, 4>& shares) const {
  const auto [u, v] = parameters(element, shares);
  return {cell(u), cell(v)};
}

void ResidualTable::find_rough(std::span<const double> tolerance) {
  const size_t of_element = steps() * steps();
  rough_.assign(cage_.elements().size() * of_element, 0);
  parallel_for(cage_.elements().size(), 1, [&](size_t begin, size_t end) {
    for (size_t e = begin; e < end; ++e)
      find_rough(static_cast<uint32_t>(e), tolerance[e], std::span(rough_).subspan(e * of_element, of_element));
  });
  if (std::find(rough_.begin(), rough_.end(), 1) == rough_.end()) rough_ = {};
}

// A bend within a step shows in the slopes before and after it. Of a parabola a straight line is off by an eighth of
// what slopes change by over a step, times the step; of a sharp bend by a quarter.
void ResidualTable::find_rough(uint32_t element, double tolerance, std::span<uint8_t> rough) const {
  const size_t side = position_.size(), count = steps();
  const float* const rows = rows_.data() + element * nodes_of_element() * columns_;
  std::vector<double> change(side);  // of slopes at a node, the most of all columns
  for (const bool along_u : {true, false}) {
    const size_t step = along_u ? 1 : side, across = along_u ? side : 1;
    for (size_t line = 0; line < side; ++line) {
      const auto value = [&](size_t i, size_t column) {
        return double{rows[(line * across + i * step) * columns_ + column]};
      };
      std::fill(change.begin(), change.end(), 0.0);
      for (size_t i = 1; i < count; ++i) {
        const double before = 1 / (position_[i] - position_[i - 1]), after = 1 / (position_[i + 1] - position_[i]);
        for (size_t c = 0; c < columns_; ++c)
          change[i] = std::max(
              change[i], std::abs((value(i + 1, c) - value(i, c)) * after - (value(i, c) - value(i - 1, c)) * before));
      }
      for (size_t i = 0; i < count; ++i) {
        if ((change[i] + change[i + 1]) * (position_[i + 1] - position_[i]) <= 8 * tolerance) continue;
        // The cells on both sides of the line.
        for (const size_t beside : {line, line - 1})
          if (beside < count) rough[along_u ? beside * count + i : i * count + beside] = 1;
      }
    }
  }
}

bool ResidualTable::is_rough(uint32_t element, const std::array<double, 4>& shares) const {
  if (rough_.empty()) return false;
  const auto [u, v] = cells(element, shares);
  return rough_[(element * steps() + v.first) * steps() + u.first] != 0;
}

void ResidualTable::add(uint32_t element, const std::array<double, 4>& shares, double weight,
                        std::span<double> sum) const {
  const auto [u, v] = cells(element, shares);
  const size_t side = position_.size();
  const float* const row = rows_.data() + (element * nodes_of_element() + v.first * side + u.first) * columns_;
  const double a = weight * (1 - u.part) * (1 - v.part), b = weight * u.part * (1 - v.part),
               c = weight * (1 - u.part) * v.part, d = weight * u.part * v.part;
  const float *const next_u = row + columns_, *const next_v = row + side * columns_, *const next_uv = next_v + columns_;
  for (size_t k = 0; k < sum.size(); ++k)
    sum[k] += a * double{row[k]} + b * double{next_u[k]} + c * double{next_v[k]} + d * double{next_uv[k]};
}

}  // namespace barycast
