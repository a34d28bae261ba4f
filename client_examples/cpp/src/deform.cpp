#include <algorithm>
#include <array>
#include <cmath>

#include "barycast/client/binding.h"

namespace barycast::client {
namespace {

using Position = std::array<double, 3>;

Position box_centre(std::span<const double> positions, uint32_t dimension) {
  Position centre{};
  for (uint32_t axis = 0; axis < dimension; ++axis) {
    double low = positions[axis], high = positions[axis];
    for (size_t i = axis; i < positions.size(); i += dimension) {
      low = std::min(low, positions[i]);
      high = std::max(high, positions[i]);
    }
    centre[axis] = 0.5 * (low + high);
  }
  return centre;
}

template <class Real>
std::vector<double> product(const Binding& binding, const std::vector<Real>& values, std::span<const double> posed,
                            uint32_t dimension) {
  const Position centre = box_centre(posed, dimension);
  std::vector<double> points(binding.point_count() * dimension);
  for (size_t row = 0; row < binding.point_count(); ++row) {
    Position sum{};
    for (uint64_t entry = binding.offsets[row]; entry < binding.offsets[row + 1]; ++entry) {
      const double* vertex = posed.data() + size_t{binding.indices[entry]} * dimension;
      for (uint32_t axis = 0; axis < dimension; ++axis) {
        sum[axis] += static_cast<double>(values[entry]) * (vertex[axis] - centre[axis]);
      }
    }
    for (uint32_t axis = 0; axis < dimension; ++axis) points[row * dimension + axis] = centre[axis] + sum[axis];
  }
  return points;
}

}  // namespace

Result<std::vector<double>> deform(const Binding& binding, std::span<const double> posed, uint32_t dimension) {
  const std::string field = "posed.control_vertices";
  if (dimension != 2 && dimension != 3) return input_error(field, "must have 2 or 3 coordinates per vertex");
  if (posed.size() != binding.control_vertex_count() * dimension || posed.empty()) {
    return input_error(field, "the posed cage has " + std::to_string(posed.size()) +
                                  " numbers, the binding's cage has " + std::to_string(binding.control_vertex_count()) +
                                  " control vertices of " + std::to_string(dimension));
  }
  const auto bad = std::find_if(posed.begin(), posed.end(), [](double x) { return !std::isfinite(x); });
  if (bad != posed.end()) {
    const auto vertex = static_cast<size_t>(bad - posed.begin()) / dimension;
    return input_error(field + "[" + std::to_string(vertex) + "]", "has a coordinate that is not finite");
  }
  return std::visit([&](const auto& values) { return product(binding, values, posed, dimension); }, binding.values);
}

}  // namespace barycast::client
