#pragma once

// A cage as flat triangles in levels of detail, for engines that work in floats. On every level an element is a facet
// of one triangle (a segment: one without area), a bilinear patch one or more of two triangles each, but for those that
// corners in one place leave without area. From afar coarse
// facets do; near the cage walks ask for those that follow the patches closely.

#include <array>
#include <cstdint>
#include <vector>

#include "cage/cage.h"
#include "query/element_distance.h"

namespace barycast {

struct Facet {
  uint32_t element;
  PatchWindow window;  // of a quad
};

struct FacetTriangle {
  uint32_t facet;
  enum class Part : uint8_t {
    kFirst,
    kSecond,
    kAll
  };          // of a facet of a patch: corners 0, 1, 2, or 0, 2, 3; or either,
  Part part;  // the other one being without area
  std::array<Vec<3>, 3> corners;
};

inline constexpr size_t kFacetLevelsMax = 3;

struct FacetLevel {
  uint32_t first_triangle, triangle_count;
};

struct FacetLevels {
  std::vector<Facet> facets;
  std::vector<double> deviation;         // by facet: of the patch from its triangles, at most, and the other way round
  std::vector<FacetTriangle> triangles;  // those of a level in a row
  std::vector<FacetLevel> levels;        // from coarse to fine; each is the whole cage
};

template <int D>
FacetLevels make_facet_levels(const Cage<D>& cage);

}  // namespace barycast
