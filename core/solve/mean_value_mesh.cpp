#include <map>
#include <utility>

#include "solve/mean_value_weights.h"

namespace barycast {

MeanValueMesh::MeanValueMesh(const Cage<3>& cage) {
  std::map<std::pair<uint32_t, uint32_t>, uint32_t> numbers;
  nodes.assign(cage.control_vertices().begin(), cage.control_vertices().end());
  const auto put = [&](uint32_t node, const Vec<3>& position) {
    if (node >= nodes.size()) nodes.resize(node + 1, Vec<3>::Zero());
    nodes[node] = position;
  };
  for (const Element& element : cage.elements()) {
    Triangle triangle;
    std::array<Vec<3>, 3> edge;
    const Vec<3>& a = cage.corner(element, 0);
    const Vec<3> doubled = (cage.corner(element, 1) - a).cross(cage.corner(element, 2) - a);
    triangle.area = doubled.norm() / 2;
    triangle.normal = doubled.normalized();
    for (int k = 0; k < 3; ++k) {
      const auto i = static_cast<size_t>(k), next = (i + 1) % 3, last = (i + 2) % 3;
      const uint32_t from = element.node[next], to = element.node[last];
      put(element.node[i], cage.corner(element, k));
      edge[i] = cage.corner(element, static_cast<int>(last)) - cage.corner(element, static_cast<int>(next));
      const auto [at, is_new] =
          numbers.try_emplace({std::min(from, to), std::max(from, to)}, static_cast<uint32_t>(edges.size()));
      triangle.node[i] = element.node[i];
      triangle.edge[i] = at->second;
      triangle.sign[i] = from < to ? 1.0 : -1.0;
      triangle.length[i] = edge[i].norm();
      triangle.rise[i] = triangle.normal.cross(edge[i]);
      if (is_new) edges.push_back({std::min(from, to), std::max(from, to), triangle.length[i]});
    }
    for (size_t i = 0; i < 3; ++i) triangle.product[i] = edge[(i + 1) % 3].dot(edge[(i + 2) % 3]);
    triangles.push_back(triangle);
  }
}

size_t MeanValueMesh::bytes() const {
  return sizeof(*this) + nodes.capacity() * sizeof(Vec<3>) + edges.capacity() * sizeof(Edge) +
         triangles.capacity() * sizeof(Triangle);
}

MeanValueSums::MeanValueSums(const MeanValueMesh& mesh, bool with_gradients) {
  const auto nodes = static_cast<Eigen::Index>(mesh.nodes.size()), edges = static_cast<Eigen::Index>(mesh.edges.size());
  const Eigen::Index slopes = with_gradients ? 1 : 0;
  weights.resize(4, nodes);
  gradients.resize(4, 3 * nodes * slopes);
  to_node.resize(4, 3 * nodes);
  cross.resize(4, 3 * edges);
  angle.resize(4, edges);
  angle_slope.resize(4, 3 * edges * slopes);
  fourth_moment.resize(4, edges * slopes);
}

}  // namespace barycast
