#pragma once

// The cage: validated, immutable, in its normalized frame [SBC 3].
//
// Control vertices and elements between them: segments in the plane; triangles, bilinear quads and
// polygons in space. Open, disconnected, non-manifold and soups are all fine. `Cage::create` is the
// only door: a Cage that exists is valid. The normalized frame has its origin at the centre of the
// bounding box of the used control vertices and its unit is that box's diagonal; all of `core` works
// there. Reading is thread-safe. Cost: a few hundred bytes per element.

#include <array>
#include <cstdint>
#include <span>
#include <variant>
#include <vector>

#include "base/result.h"
#include "base/vector.h"
#include "base/warning.h"

namespace barycast {

// A cage as it arrives, in the caller's units. Borrowed: nothing is copied. Indices may be anything;
// `Cage::create` checks them.
struct CageInput {
  int dimension = 3;                          // 2 or 3
  std::span<const double> control_vertices;   // n x dimension, row-major
  std::span<const uint32_t> segments;         // k x 2
  std::span<const uint32_t> triangles;        // k x 3
  std::span<const uint32_t> quads;            // k x 4, corners in cyclic order
  std::span<const uint32_t> polygon_offsets;  // k + 1, starting at 0; or empty
  std::span<const uint32_t> polygon_corners;  // c
};

// Triangles that the surface of a cage is: quads count twice, larger polygons by their corners.
uint64_t surface_triangles(const CageInput& input);

enum class ElementKind : uint8_t { kSegment, kTriangle, kQuad };

// One element: its corners are nodes of the cage. A polygon of five or more corners becomes several
// triangles that share a node at the mean of its corners.
struct Element {
  ElementKind kind;
  std::array<uint32_t, 4> node;  // 2, 3 or 4 of them are used
  int corner_count() const { return 2 + static_cast<int>(kind); }
};

// A control vertex with its share of something.
struct VertexWeight {
  uint32_t vertex;
  double weight;
};

// The map between the caller's frame and the normalized one: normalized = (x - centre) / diagonal.
template <int D>
struct Frame {
  Vec<D> centre = Vec<D>::Zero();
  double diagonal = 1.0;
  Vec<D> to_normalized(const Vec<D>& x) const { return (x - centre) / diagonal; }
  Vec<D> to_caller(const Vec<D>& x) const { return x * diagonal + centre; }
};

template <int D>
class Cage {
 public:
  // Errors: kInvalidArgument with the path of the field (non-finite coordinate, index out of range,
  // no elements or only degenerate ones, used vertices that do not span space).
  static Result<Cage> create(const CageInput& input);

  const Frame<D>& frame() const { return frame_; }
  // All control vertices, used or not, normalized; the columns of every row.
  std::span<const Vec<D>> control_vertices() const { return {nodes_.data(), control_vertex_count_}; }
  uint32_t control_vertex_count() const { return control_vertex_count_; }
  // Control vertices that elements use, ascending.
  std::span<const uint32_t> used_vertices() const { return used_; }

  // Elements in canonical order; where two are equally near, the lower index decides.
  std::span<const Element> elements() const { return elements_; }
  size_t node_count() const { return nodes_.size(); }
  const Vec<D>& corner(const Element& element, int i) const { return nodes_[element.node[static_cast<size_t>(i)]]; }

  // The basis phi_v that Eq. 1 sums over [SBC Eq. 1]: calls body(v, weight * phi_v) for a point of an element with the
  // given corner shares (they sum to one). A vertex may occur more than once.
  template <class Body>
  void for_each_basis(const Element& element, std::span<const double> corner_shares, double weight,
                      const Body& body) const {
    for (int i = 0; i < element.corner_count(); ++i) {
      const double share = weight * corner_shares[static_cast<size_t>(i)];
      if (share == 0.0) continue;
      const uint32_t node = element.node[static_cast<size_t>(i)];
      if (node < control_vertex_count()) {
        body(node, share);
      } else {
        for (const VertexWeight& entry : stencil(node)) body(entry.vertex, share * entry.weight);
      }
    }
  }
  // The same to the end of `basis`.
  void append_basis(const Element& element, std::span<const double> corner_shares, double weight,
                    std::vector<VertexWeight>& basis) const;
  // The control vertices behind a node: itself, or the corners of its polygon.
  std::span<const VertexWeight> stencil(uint32_t node) const;

  // Most control vertices behind one point of the cage: 4, or the corners of its largest polygon.
  uint32_t stencil_max() const;

  // +1 where element normals point outwards on the whole, -1 where inwards: the sign of the enclosed
  // volume (area) as computed from the elements about the centre.
  double orientation() const { return orientation_; }

  std::span<const Warning> warnings() const { return warnings_; }
  // Of its input.
  uint64_t surface_triangles() const { return surface_triangles_; }
  size_t bytes() const;

 private:
  Cage() = default;
  Frame<D> frame_;
  uint32_t control_vertex_count_ = 0;
  std::vector<Vec<D>> nodes_;              // control vertices, then polygon centres
  std::vector<uint32_t> stencil_offsets_;  // per node, into stencils_
  std::vector<VertexWeight> stencils_;
  std::vector<uint32_t> used_;
  std::vector<Element> elements_;
  double orientation_ = 1.0;
  uint64_t surface_triangles_ = 0;
  std::vector<Warning> warnings_;
};

extern template class Cage<2>;
extern template class Cage<3>;

}  // namespace barycast
