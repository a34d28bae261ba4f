#include "solve/lanes.h"
#include "solve/mean_value_weights.h"

HWY_BEFORE_NAMESPACE();
namespace barycast {
namespace {

// Gauss-Legendre on [0, 1], a tensor of two on the triangle, one of its corners being an edge of the square. Beyond
// kExactFar, the nearest pole of |y - x|^-4 is at least 3.5 away from the middle of an edge of length 1 at most: errors
// fall like (7 + sqrt(48))^(-2 n), to 1e-16 at n = 7.
constexpr size_t kNodes = 7;
constexpr double kNode[kNodes] = {0.025446043828620736, 0.12923440720030277, 0.2970774243113014, 0.5,
                                  0.7029225756886985,   0.8707655927996972,  0.9745539561713793};
constexpr double kWeight[kNodes] = {0.06474248308443487, 0.13985269574463835, 0.19091502525255943, 0.20897959183673473,
                                    0.19091502525255943, 0.13985269574463835, 0.06474248308443487};

template <bool kGradients>
HWY_INLINE void visit_triangle(const MeanValueMesh::Triangle& triangle, MeanValueSums& sums) {
  const Lane3 corner[3] = {load3(sums.to_node, triangle.node[0]), load3(sums.to_node, triangle.node[1]),
                           load3(sums.to_node, triangle.node[2])};
  const Lane3 normal = all(triangle.normal);
  const Lane h = dot(normal, corner[0]);
  const Lane zero = all(0.0);
  Lane sum[3] = {zero, zero, zero};
  Lane3 slope[3] = {{zero, zero, zero}, {zero, zero, zero}, {zero, zero, zero}};
  for (size_t i = 0; i < kNodes; ++i)
    for (size_t j = 0; j < kNodes; ++j) {
      const double share[3] = {(1 - kNode[i]) * (1 - kNode[j]), kNode[i] * (1 - kNode[j]), kNode[j]};
      const Lane3 to = mul_add(corner[0], all(share[0]), mul_add(corner[1], all(share[1]), corner[2] * all(share[2])));
      const Lane inverse = hn::Div(all(1.0), dot(to, to));  // |y - x|^-2
      const double weight = 2 * triangle.area * kWeight[i] * kWeight[j] * (1 - kNode[j]);
      const Lane density = hn::Mul(hn::Mul(inverse, inverse), all(weight));
      for (size_t k = 0; k < 3; ++k) {
        sum[k] = hn::MulAdd(density, all(share[k]), sum[k]);
        if constexpr (kGradients) slope[k] = mul_add(to, hn::Mul(hn::Mul(density, all(share[k])), inverse), slope[k]);
      }
    }
  for (size_t k = 0; k < 3; ++k) {
    add_to(hn::Mul(h, sum[k]), sums.weights, triangle.node[k]);
    if constexpr (kGradients)
      add_to3(slope[k] * hn::Mul(h, all(4.0)) - normal * sum[k], sums.gradients, triangle.node[k]);
  }
}

template <bool kGradients>
void visit(const MeanValueMesh& mesh, const PointsAtOnce& points, MeanValueSums& sums) {
  const Lane3 x = gather(points);
  for (size_t i = 0; i < mesh.nodes.size(); ++i) store3(all(mesh.nodes[i]) - x, sums.to_node, i);
  for (const auto& triangle : mesh.triangles) visit_triangle<kGradients>(triangle, sums);
}

}  // namespace

void add_far_weights(const MeanValueMesh& mesh, const PointsAtOnce& points, MeanValueSums& sums) {
  sums.weights.setZero();
  sums.gradients.setZero();
  sums.on_cage.fill(false);
  if (sums.gradients.size() > 0)
    visit<true>(mesh, points, sums);
  else
    visit<false>(mesh, points, sums);
}

}  // namespace barycast
HWY_AFTER_NAMESPACE();
