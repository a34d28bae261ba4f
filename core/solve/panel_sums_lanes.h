#pragma once

// The inner loops of panel_sums.h, in vectors of the processor's width (AVX2 or AVX-512, chosen when the program
// runs). A lane is a query point: it never sees its neighbours, and every sum runs over the panels in their order, so
// that results are the same bits for both.

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

namespace barycast {

// Points at a time, and panels whose kernels are kept at a time: a hundred kilobytes with gradients.
inline constexpr size_t kSumPoints = 64;
inline constexpr size_t kSumPanels = 32, kSumRows = 3 * kSumPanels;
// Degree of local expansions, and their terms.
inline constexpr size_t kSumDegree = 6, kSumTerms = (kSumDegree + 1) * (kSumDegree + 1);
static_assert(kSumTerms <= kSumRows);
// Columns come in multiples of this, and points are rounded up to it.
inline constexpr size_t kSumLanes = 16;

// Makes arrays of floats aligned.
struct alignas(64) SumLine {
  std::array<float, kSumLanes> lane;
};
// That hold so many floats.
constexpr size_t sum_lines(size_t floats) {
  return (floats + kSumLanes - 1) / kSumLanes;
}

// A panel as points, about its centre.
struct SumPoints {
  std::array<float, 3> centre, normal;
  float charge;                                           // a third of the area
  std::array<std::array<float, 3>, 3> point;              // of the density's values
  std::array<std::array<float, 3>, 7> rule, rule_charge;  // points of kTriangleRule; charges of the three functions
  float three_point_squared, seven_point_squared, exact_squared;  // squared distances from which each will do
};

// A panel as it is, about its centre. Edge e runs from corner e to the next.
template <class T>
struct SumTriangle {
  using Vector = std::array<T, 3>;
  Vector centre, normal;
  std::array<Vector, 3> corner, along, outward;  // of edges: unit vectors in the plane
  Vector length, start, distance;                // of edges; where they start along themselves; their line's distance
  std::array<Vector, 3> slope;                   // of the density's functions
  std::array<Vector, 3> across, alongside;       // slope k times outward e and along e, at [k][e]
  T area;
};

// Dipoles of the panels of an element are summed as shares of its corners; those then go to columns.
struct SumElement {
  uint32_t end_panel, end_entry;  // one beyond the last
};
struct SumEntry {
  uint32_t corner, column;
  float weight;
};

// What does not change. Spans are borrowed; those of dipoles are empty where there are none.
struct SumTables {
  std::span<const SumPoints> points;  // by panel, and so the next two
  std::span<const SumTriangle<float>> triangles;
  std::span<const SumTriangle<double>> exact_triangles;
  const float* densities;                                       // a row per point of a panel, aligned
  size_t density_stride;                                        // a multiple of kSumLanes
  std::span<const std::array<std::array<float, 4>, 3>> shares;  // by panel and its point
  std::span<const SumElement> elements;
  std::span<const SumEntry> entries;
  size_t basis_count;
};

// A local expansion: what panels that are far from a ball add up to inside of it, as a sum of solid harmonics of
// (x - centre) / radius.
struct SumExpansion {
  std::array<float, 3> centre;
  float inverse_radius;
  const float* coefficients;  // a row per term, aligned
  size_t stride;              // a multiple of kSumLanes
  const float* enclosed;      // coefficients of that
};

// Aligned arrays for a batch. Tables of one row are for values; with gradients four follow each other.
struct SumBatch {
  size_t points;                         // up to kSumPoints
  size_t lanes;                          // the same, rounded up to kSumLanes
  std::array<const float*, 3> x;         // kSumPoints each
  std::array<const double*, 3> exact_x;  // the same, unrounded
  float* kernels;                        // rows x kSumRows x kSumPoints
  float* sums;                           // rows x kSumPoints x columns; in and out
  float* corner_sums;                    // rows x 4 x kSumPoints; in and out
  float* basis_sums;                     // rows x basis_count x kSumPoints; in and out
  float* enclosed;                       // kSumPoints; in and out
};

// Adds the potentials of panels, of which there is an ascending list: of the densities to `sums`, of the dipoles to
// `basis_sums` and `enclosed`. `columns`: a multiple of kSumLanes.
void add_panel_sums(const SumTables& tables, std::span<const uint32_t> panels, bool gradients, size_t columns,
                    const SumBatch& batch);

// The same of panels that are expanded; dipoles are in their columns' coefficients.
void add_expansion(const SumExpansion& expansion, bool gradients, size_t columns, const SumBatch& batch);

}  // namespace barycast
