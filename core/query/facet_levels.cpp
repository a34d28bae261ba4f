#include "query/facet_levels.h"

#include <algorithm>
#include <limits>

namespace barycast {
namespace {

// Patches are cut until triangles follow them within this part of their size: the closest point of such a facet is
// found by Newton from its triangles.
constexpr double kDeviationOfSize = 0.05;
// Deviations of the levels, in diagonals. The finest is a quarter of the default thickness: coarser, and walks ask for
// exact distances before they arrive; finer, and cells list more triangles.
constexpr std::array<double, kFacetLevelsMax> kDeviationMax = {std::numeric_limits<double>::infinity(), 4e-3, 2.4e-4};
constexpr int kCutsMax = 6;
// A level with more triangles than this is left out: distances are decided exactly without it, only later.
constexpr size_t kTrianglesMax = size_t{1} << 15;

template <int D>
Vec<3> in_space(const Vec<D>& x) {
  Vec<3> result = Vec<3>::Zero();
  result.template head<D>() = x;
  return result;
}

void add_patch(const BilinearPatch& patch, uint32_t element, double deviation_max, FacetLevels& out) {
  for (const PatchWindow& window : patch_windows(patch.cuts(deviation_max, kDeviationOfSize, kCutsMax))) {
    const BilinearPatch part = patch.part(window);
    const auto facet = static_cast<uint32_t>(out.facets.size());
    out.facets.push_back({element, window});
    out.deviation.push_back(part.triangle_deviation());
    const auto& c = part.corner;
    // Two corners of a triangle in one place leave it a side of the other one.
    using Part = FacetTriangle::Part;
    const bool no_first = c[0] == c[1] || c[1] == c[2], no_second = !no_first && (c[2] == c[3] || c[3] == c[0]);
    if (!no_first) out.triangles.push_back({facet, no_second ? Part::kAll : Part::kFirst, {c[0], c[1], c[2]}});
    if (!no_second) out.triangles.push_back({facet, no_first ? Part::kAll : Part::kSecond, {c[0], c[2], c[3]}});
  }
}

template <int D>
void add_level(const Cage<D>& cage, double deviation_max, FacetLevels& out) {
  const auto first = static_cast<uint32_t>(out.triangles.size());
  for (uint32_t e = 0; e < cage.elements().size(); ++e) {
    const Element& element = cage.elements()[e];
    if constexpr (D == 3) {
      if (element.kind == ElementKind::kQuad) {
        add_patch(patch_of(cage, element), e, deviation_max, out);
        continue;
      }
    }
    const int last = element.corner_count() == 2 ? 0 : 2;  // a segment comes back to its first corner
    const auto corner = [&](int i) { return in_space<D>(cage.corner(element, i)); };
    out.triangles.push_back(
        {static_cast<uint32_t>(out.facets.size()), FacetTriangle::Part::kAll, {corner(0), corner(1), corner(last)}});
    out.facets.push_back({e, {}});
    out.deviation.push_back(0.0);
  }
  out.levels.push_back({first, static_cast<uint32_t>(out.triangles.size()) - first});
}

template <int D>
size_t triangles_of_level(const Cage<D>& cage, double deviation_max) {
  size_t count = cage.elements().size();
  if constexpr (D == 3)
    for (const Element& element : cage.elements())
      if (element.kind == ElementKind::kQuad)
        count += (size_t{2} << (2 * patch_of(cage, element).cuts(deviation_max, kDeviationOfSize, kCutsMax))) - 1;
  return count;
}

}  // namespace

template <int D>
FacetLevels make_facet_levels(const Cage<D>& cage) {
  FacetLevels result;
  for (const double deviation_max : kDeviationMax) {
    if (!result.levels.empty() && triangles_of_level(cage, deviation_max) > kTrianglesMax) break;
    add_level(cage, deviation_max, result);
    const double deviation = *std::max_element(result.deviation.begin(), result.deviation.end());
    if (result.levels.size() == 1 && deviation <= kDeviationMax.back()) break;  // finer ones would be the same
  }
  return result;
}

template FacetLevels make_facet_levels(const Cage<2>&);
template FacetLevels make_facet_levels(const Cage<3>&);

}  // namespace barycast
