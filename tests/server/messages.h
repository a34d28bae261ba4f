#pragma once

// Messages that the tests start from: a sound request about a tetrahedron, to be spoilt one field at a time.

#include <cstring>
#include <string>
#include <vector>

#include "barycast/v1/barycast.pb.h"

namespace barycast::server::testing {

template <class T>
v1::Array array(v1::DataType type, uint32_t columns, const std::vector<T>& values) {
  v1::Array result;
  result.set_type(type);
  result.set_columns(columns);
  result.set_rows(values.size() / columns);
  result.set_data(values.data(), values.size() * sizeof(T));
  return result;
}

inline v1::Array doubles(uint32_t columns, const std::vector<double>& v) {
  return array(v1::DATA_TYPE_FLOAT64, columns, v);
}
inline v1::Array floats(uint32_t columns, const std::vector<float>& v) {
  return array(v1::DATA_TYPE_FLOAT32, columns, v);
}
inline v1::Array indices(uint32_t columns, const std::vector<uint32_t>& v) {
  return array(v1::DATA_TYPE_UINT32, columns, v);
}

// Corners 0, x, y, z scaled by `size`: the coordinates of (x, y, z) are (1 - x - y - z, x, y, z) at size 1.
inline v1::Cage tetrahedron(double size = 1.0) {
  v1::Cage cage;
  *cage.mutable_control_vertices() = doubles(3, {0, 0, 0, size, 0, 0, 0, size, 0, 0, 0, size});
  *cage.mutable_triangles() = indices(3, {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3});
  return cage;
}

inline v1::Cage square() {
  v1::Cage cage;
  *cage.mutable_control_vertices() = doubles(2, {0, 0, 1, 0, 1, 1, 0, 1});
  *cage.mutable_segments() = indices(2, {0, 1, 1, 2, 2, 3, 3, 0});
  return cage;
}

inline v1::ComputeCoordinatesRequest header(uint64_t points, const v1::Cage& cage = tetrahedron()) {
  v1::ComputeCoordinatesRequest request;
  *request.mutable_header()->mutable_inline_cage() = cage;
  request.mutable_header()->mutable_queries()->set_point_count(points);
  request.mutable_header()->mutable_output()->set_type(v1::DATA_TYPE_FLOAT64);
  return request;
}

inline v1::ComputeCoordinatesRequest points(const std::vector<double>& values, uint32_t columns = 3) {
  v1::ComputeCoordinatesRequest request;
  *request.mutable_points()->mutable_points() = doubles(columns, values);
  return request;
}

inline v1::ComputeCoordinatesRequest faces(const std::vector<uint32_t>& counts, const std::vector<uint32_t>& corners) {
  v1::ComputeCoordinatesRequest request;
  *request.mutable_faces()->mutable_corner_counts() = indices(1, counts);
  *request.mutable_faces()->mutable_corners() = indices(1, corners);
  return request;
}

// Distinct points inside the unit tetrahedron, n x 3.
inline std::vector<double> inner_points(size_t count) {
  std::vector<double> result;
  for (size_t i = 0; i < count; ++i) {
    const double t = (static_cast<double>(i) + 0.5) / static_cast<double>(count);
    result.insert(result.end(), {0.05 + 0.2 * t, 0.3 - 0.2 * t, 0.1 + 0.1 * t});
  }
  return result;
}

template <class T>
std::vector<T> numbers(const v1::Array& array) {
  std::vector<T> result(array.data().size() / sizeof(T));
  if (!result.empty()) std::memcpy(result.data(), array.data().data(), result.size() * sizeof(T));
  return result;
}

}  // namespace barycast::server::testing
