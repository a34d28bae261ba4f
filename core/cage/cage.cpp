#include "cage/cage.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>

#include "base/tolerances.h"

namespace barycast {
namespace {

std::string element_path(const char* list, size_t index) {
  return std::string("cage.") + list + "[" + std::to_string(index) + "]";
}

// Whether an element is a point, or a face without area, to rounding. In the normalized frame, where
// corners that differ in the caller's may coincide.
template <int D>
bool is_degenerate(std::span<const Vec<D>> corners) {
  double edge_squared = 0.0;
  for (size_t i = 0; i < corners.size(); ++i)
    for (size_t j = 0; j < i; ++j) edge_squared = std::max(edge_squared, (corners[i] - corners[j]).squaredNorm());
  if (edge_squared < kDegenerate * kDegenerate) return true;
  if constexpr (D == 2) {
    return false;
  } else {
    double area = 0.0;
    for (size_t i = 0; i < corners.size(); ++i) {
      const Vec<3>& a = corners[i];
      const Vec<3>& b = corners[(i + 1) % corners.size()];
      const Vec<3>& c = corners[(i + 2) % corners.size()];
      area = std::max(area, (b - a).cross(c - a).norm());
    }
    return area < kDegenerate * edge_squared;
  }
}

// Collects elements that are worth keeping, and says which were not.
template <int D>
class ElementBuilder {
 public:
  ElementBuilder(std::vector<Vec<D>>& nodes, const Frame<D>& frame)
      : used(nodes.size()), nodes_(nodes), frame_(frame), vertex_count_(static_cast<uint32_t>(nodes.size())) {}

  Status add_list(const char* list, ElementKind kind, std::span<const uint32_t> indices) {
    const size_t corners = 2 + static_cast<size_t>(kind);
    if (indices.size() % corners != 0)
      return invalid_argument(std::string("cage.") + list,
                              "the number of indices must be a multiple of " + std::to_string(corners));
    for (size_t i = 0; i < indices.size() / corners; ++i)
      if (auto status = add(list, i, indices.subspan(i * corners, corners)); !status) return status;
    report(list);
    return Done{};
  }

  Status add_polygons(std::span<const uint32_t> offsets, std::span<const uint32_t> corners) {
    if (offsets.empty()) {
      if (!corners.empty()) return invalid_argument("cage.polygons.corners", "there are corners, but no offsets");
      return Done{};
    }
    if (offsets.front() != 0) return invalid_argument("cage.polygons.offsets[0]", "must be 0");
    if (offsets.back() != corners.size())
      return invalid_argument("cage.polygons.offsets[" + std::to_string(offsets.size() - 1) + "]",
                              "must be the number of corners, " + std::to_string(corners.size()));
    for (size_t i = 0; i + 1 < offsets.size(); ++i) {
      if (offsets[i + 1] < offsets[i] || offsets[i + 1] > corners.size())
        return invalid_argument("cage.polygons.offsets[" + std::to_string(i + 1) + "]", "offsets must not decrease");
      const size_t count = offsets[i + 1] - offsets[i];
      if (count < 3)
        return invalid_argument(element_path("polygons", i),
                                "has " + std::to_string(count) + " corners; 3 or more are needed");
      if (auto status = add("polygons", i, corners.subspan(offsets[i], count)); !status) return status;
    }
    report("polygons");
    return Done{};
  }

  std::vector<Element> elements;
  std::vector<std::vector<VertexWeight>> centre_stencils;  // of the nodes behind the control vertices
  std::vector<Warning> warnings;
  std::vector<bool> used;

 private:
  Status add(const char* list, size_t index, std::span<const uint32_t> corners) {
    for (size_t i = 0; i < corners.size(); ++i)
      if (corners[i] >= vertex_count_)
        return invalid_argument(
            element_path(list, index) + ".vertex[" + std::to_string(i) + "]",
            "index " + std::to_string(corners[i]) + " >= " + std::to_string(vertex_count_) + " control vertices");
    const size_t before = elements.size();
    if (corners.size() <= 4) {
      keep({corners.begin(), corners.end()});
    } else {
      add_fan(corners);
    }
    if (elements.size() == before) {
      if (degenerate_count_++ == 0) degenerate_first_ = index;
    } else {
      for (const uint32_t vertex : corners) used[vertex] = true;
    }
    return Done{};
  }

  // A fan around the mean of the corners, whose basis is the corners' mean: positions and basis agree,
  // so linear precision holds on the fan as on any triangle.
  void add_fan(std::span<const uint32_t> corners) {
    const auto centre = static_cast<uint32_t>(nodes_.size());
    Vec<D> mean = Vec<D>::Zero();
    std::vector<VertexWeight> stencil;
    for (const uint32_t vertex : corners) {
      mean += nodes_[vertex];
      stencil.push_back({vertex, 1.0 / static_cast<double>(corners.size())});
    }
    nodes_.push_back(mean / static_cast<double>(corners.size()));
    centre_stencils.push_back(std::move(stencil));
    for (size_t i = 0; i < corners.size(); ++i) keep({centre, corners[i], corners[(i + 1) % corners.size()]});
  }

  void keep(const std::vector<uint32_t>& nodes) {
    std::vector<Vec<D>> corners;
    Element element{static_cast<ElementKind>(nodes.size() - 2), {}};
    for (size_t i = 0; i < nodes.size(); ++i) {
      corners.push_back(frame_.to_normalized(nodes_[nodes[i]]));
      element.node[i] = nodes[i];
    }
    if (!is_degenerate<D>(corners)) elements.push_back(element);
  }

  void report(const char* list) {
    if (degenerate_count_ > 0)
      warnings.push_back({element_path(list, degenerate_first_),
                          degenerate_count_ == 1 ? "is degenerate (no area) and was ignored"
                                                 : "is degenerate (no area) and was ignored, as were " +
                                                       std::to_string(degenerate_count_ - 1) + " more"});
    degenerate_count_ = 0;
  }

  std::vector<Vec<D>>& nodes_;
  const Frame<D>& frame_;
  uint32_t vertex_count_;
  size_t degenerate_count_ = 0, degenerate_first_ = 0;
};

template <int D>
Result<std::vector<Vec<D>>> read_vertices(std::span<const double> coordinates) {
  if (coordinates.size() % D != 0)
    return invalid_argument("cage.control_vertices",
                            "the number of coordinates must be a multiple of " + std::to_string(D));
  if (coordinates.size() / D > 0xFFFFFFF0u)
    return invalid_argument("cage.control_vertices", "more than 2^32 control vertices");
  std::vector<Vec<D>> nodes(coordinates.size() / D);
  for (size_t v = 0; v < nodes.size(); ++v) {
    for (int i = 0; i < D; ++i) {
      const double coordinate = coordinates[v * D + static_cast<size_t>(i)];
      if (!std::isfinite(coordinate))
        return invalid_argument("cage.control_vertices[" + std::to_string(v) + "]",
                                "has a coordinate that is not finite");
      if (std::abs(coordinate) > kCoordinateMax)
        return invalid_argument("cage.control_vertices[" + std::to_string(v) + "]", "has a coordinate beyond 1e100");
      nodes[v][i] = coordinate + 0.0;
    }
  }
  return nodes;
}

template <int D>
Frame<D> bounding_frame(const std::vector<Vec<D>>& nodes, std::span<const uint32_t> used) {
  Vec<D> low = nodes[used[0]], high = low;
  for (const uint32_t v : used) {
    low = low.cwiseMin(nodes[v]);
    high = high.cwiseMax(nodes[v]);
  }
  // Scaled by the largest extent, so that nothing over- or underflows and a cage scaled by a power of
  // two has its frame scaled without rounding.
  const Vec<D> extent = high - low;
  const double largest = extent.maxCoeff();
  if (!(largest > 0.0)) return Frame<D>{low, 1.0};  // all in one place: every element is degenerate
  return Frame<D>{low * 0.5 + high * 0.5, largest * (extent / largest).norm()};
}

// Valid indices of any element, ascending.
std::vector<uint32_t> mentioned_vertices(const CageInput& input, uint32_t vertex_count) {
  std::vector<bool> mentioned(vertex_count);
  for (const auto& list : {input.segments, input.triangles, input.quads, input.polygon_corners})
    for (const uint32_t v : list)
      if (v < vertex_count) mentioned[v] = true;
  std::vector<uint32_t> result;
  for (uint32_t v = 0; v < vertex_count; ++v)
    if (mentioned[v]) result.push_back(v);
  return result;
}

template <int D>
bool spans_space(std::span<const Vec<D>> nodes, std::span<const uint32_t> used) {
  Vec<D> mean = Vec<D>::Zero();
  for (const uint32_t v : used) mean += nodes[v];
  mean /= static_cast<double>(used.size());
  Eigen::Matrix<double, Eigen::Dynamic, D> centred(static_cast<Eigen::Index>(used.size()), D);
  for (size_t i = 0; i < used.size(); ++i)
    centred.row(static_cast<Eigen::Index>(i)) = (nodes[used[i]] - mean).transpose();
  // The covariance squares the ratio; 1e-10 is still well above rounding.
  const Eigen::SelfAdjointEigenSolver<Mat<D>> solver(Mat<D>(centred.transpose() * centred), Eigen::EigenvaluesOnly);
  return solver.eigenvalues()[0] > kSpanRatioMin * kSpanRatioMin * solver.eigenvalues()[D - 1];
}

// Enclosed area (D = 2) or volume (D = 3) about the origin, signed by the elements' orientation.
template <int D>
double signed_volume(const std::vector<Vec<D>>& nodes, const std::vector<Element>& elements) {
  double volume = 0.0;
  for (const Element& element : elements) {
    const Vec<D>& a = nodes[element.node[0]];
    const Vec<D>& b = nodes[element.node[1]];
    if constexpr (D == 2) {
      volume += a[0] * b[1] - a[1] * b[0];
    } else {
      const Vec<D>& c = nodes[element.node[2]];
      volume += a.dot(b.cross(c));
      if (element.kind == ElementKind::kQuad) volume += a.dot(c.cross(nodes[element.node[3]]));
    }
  }
  return volume;
}

}  // namespace

uint64_t surface_triangles(const CageInput& input) {
  uint64_t count = input.triangles.size() / 3 + 2 * (input.quads.size() / 4);
  for (size_t p = 1; p < input.polygon_offsets.size(); ++p) {
    const uint32_t corners = input.polygon_offsets[p] - input.polygon_offsets[p - 1];
    count += corners > 4 ? corners : corners - std::min(corners, 2u);
  }
  return count;
}

template <int D>
Result<Cage<D>> Cage<D>::create(const CageInput& input) {
  BARYCAST_CHECK_OP(input.dimension, ==, D);
  auto read = read_vertices<D>(input.control_vertices);
  if (!read) return read.error();
  Cage cage;
  cage.nodes_ = std::move(read).value();
  cage.control_vertex_count_ = static_cast<uint32_t>(cage.nodes_.size());

  if (D == 3 && !input.segments.empty())
    return Error{ErrorCode::kUnimplemented, "cage.segments", "curve networks in space are not built yet; use faces"};
  if (D == 2 && !(input.triangles.empty() && input.quads.empty() && input.polygon_corners.empty()))
    return invalid_argument(!input.triangles.empty() ? "cage.triangles"
                            : !input.quads.empty()   ? "cage.quads"
                                                     : "cage.polygons",
                            "a cage in the plane is made of segments");
  const auto mentioned = mentioned_vertices(input, cage.control_vertex_count_);
  if (mentioned.empty())
    return invalid_argument("cage", "has no elements; a cage needs segments (in the plane) or faces (in space)");
  const Frame<D> outer = bounding_frame<D>(cage.nodes_, mentioned);
  ElementBuilder<D> builder(cage.nodes_, outer);
  if (auto status = builder.add_list("segments", ElementKind::kSegment, input.segments); !status) return status.error();
  if (auto status = builder.add_list("triangles", ElementKind::kTriangle, input.triangles); !status)
    return status.error();
  if (auto status = builder.add_list("quads", ElementKind::kQuad, input.quads); !status) return status.error();
  if (auto status = builder.add_polygons(input.polygon_offsets, input.polygon_corners); !status) return status.error();
  if (builder.elements.empty())
    return invalid_argument(builder.warnings[0].field, "every element of the cage is degenerate (no area)");

  cage.elements_ = std::move(builder.elements);
  cage.warnings_ = std::move(builder.warnings);
  for (uint32_t v = 0; v < cage.control_vertex_count_; ++v)
    if (builder.used[v]) cage.used_.push_back(v);
  if (const size_t unused = cage.control_vertex_count_ - cage.used_.size(); unused > 0)
    cage.warnings_.push_back(
        {"cage.control_vertices", std::to_string(unused) + " of " + std::to_string(cage.control_vertex_count_) +
                                      " control vertices belong to no element and influence nothing"});

  cage.frame_ = bounding_frame<D>(cage.nodes_, cage.used_);
  for (Vec<D>& node : cage.nodes_) node = cage.frame_.to_normalized(node);
  if (!spans_space<D>(cage.control_vertices(), cage.used_))
    return invalid_argument(
        "cage.control_vertices",
        D == 3 ? "the used control vertices lie in a plane; they must span space (a cage in the plane has two "
                 "coordinates per vertex, and segments)"
               : "the used control vertices lie on a line; they must span the plane");
  cage.surface_triangles_ = barycast::surface_triangles(input);
  cage.orientation_ = signed_volume<D>(cage.nodes_, cage.elements_) < 0.0 ? -1.0 : 1.0;

  for (uint32_t v = 0; v < cage.control_vertex_count_; ++v) {
    cage.stencil_offsets_.push_back(v);
    cage.stencils_.push_back({v, 1.0});
  }
  for (const auto& stencil : builder.centre_stencils) {
    cage.stencil_offsets_.push_back(static_cast<uint32_t>(cage.stencils_.size()));
    cage.stencils_.insert(cage.stencils_.end(), stencil.begin(), stencil.end());
  }
  cage.stencil_offsets_.push_back(static_cast<uint32_t>(cage.stencils_.size()));
  return cage;
}

template <int D>
std::span<const VertexWeight> Cage<D>::stencil(uint32_t node) const {
  return {stencils_.data() + stencil_offsets_[node], stencil_offsets_[node + 1] - stencil_offsets_[node]};
}

template <int D>
uint32_t Cage<D>::stencil_max() const {
  uint32_t result = 4;
  for (uint32_t node = control_vertex_count_; node < nodes_.size(); ++node)
    result = std::max(result, static_cast<uint32_t>(stencil(node).size()));
  return result;
}

template <int D>
void Cage<D>::append_basis(const Element& element, std::span<const double> corner_shares, double weight,
                           std::vector<VertexWeight>& basis) const {
  for_each_basis(element, corner_shares, weight, [&](uint32_t vertex, double phi) { basis.push_back({vertex, phi}); });
}

template <int D>
size_t Cage<D>::bytes() const {
  return sizeof(*this) + nodes_.capacity() * sizeof(Vec<D>) + stencil_offsets_.capacity() * sizeof(uint32_t) +
         stencils_.capacity() * sizeof(VertexWeight) + used_.capacity() * sizeof(uint32_t) +
         elements_.capacity() * sizeof(Element);
}

template class Cage<2>;
template class Cage<3>;

}  // namespace barycast
