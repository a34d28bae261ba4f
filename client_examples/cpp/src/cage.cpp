#include "barycast/client/cage.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "digest.h"

namespace barycast::client {
namespace {

Status check_positions(const std::vector<double>& positions, uint32_t dimension, const std::string& field) {
  if (dimension != 2 && dimension != 3) {
    return input_error(field, "must have 2 or 3 coordinates per vertex, not " + std::to_string(dimension));
  }
  if (positions.size() % dimension != 0) {
    return input_error(field, "must hold a multiple of " + std::to_string(dimension) + " numbers, not " +
                                  std::to_string(positions.size()));
  }
  for (size_t i = 0; i < positions.size(); ++i) {
    if (!std::isfinite(positions[i])) {
      return input_error(field + "[" + std::to_string(i / dimension) + "]", "has a coordinate that is not finite");
    }
  }
  return Done{};
}

Error not_below(const std::string& field, uint32_t index, size_t count) {
  return input_error(field, "index " + std::to_string(index) + " is not in 0 ... " + std::to_string(count - 1));
}

Status check_elements(const std::vector<uint32_t>& corners, size_t per_element, size_t vertex_count,
                      const std::string& field) {
  if (corners.size() % per_element != 0) {
    return input_error(field, "must hold a multiple of " + std::to_string(per_element) + " indices, not " +
                                  std::to_string(corners.size()));
  }
  for (size_t i = 0; i < corners.size(); ++i) {
    if (corners[i] < vertex_count) continue;
    return not_below(field + "[" + std::to_string(i / per_element) + "][" + std::to_string(i % per_element) + "]",
                     corners[i], vertex_count);
  }
  return Done{};
}

// Moves faces of three and four corners behind the triangles and quads.
void separate_polygons(CageParts& parts) {
  Faces larger;
  for (size_t i = 0; i < parts.polygons.size(); ++i) {
    const std::span<const uint32_t> face = parts.polygons.face(i);
    if (face.size() == 3) {
      parts.triangles.insert(parts.triangles.end(), face.begin(), face.end());
    } else if (face.size() == 4) {
      parts.quads.insert(parts.quads.end(), face.begin(), face.end());
    } else {
      larger.add(face);
    }
  }
  parts.polygons = std::move(larger);
}

}  // namespace

Status check_faces(const Faces& faces, size_t vertex_count, const std::string& field) {
  if (faces.offsets.empty() || faces.offsets.front() != 0 || faces.offsets.back() != faces.corners.size()) {
    return input_error(field + ".offsets", "must start at 0 and end at the number of corners");
  }
  for (size_t i = 0; i < faces.size(); ++i) {
    if (faces.offsets[i + 1] < faces.offsets[i] || faces.offsets[i + 1] - faces.offsets[i] < 3) {
      return input_error(field + "[" + std::to_string(i) + "]", "has fewer than three corners");
    }
  }
  for (size_t i = 0; i < faces.corners.size(); ++i) {
    if (faces.corners[i] < vertex_count) continue;
    return not_below(field + ".corners[" + std::to_string(i) + "]", faces.corners[i], vertex_count);
  }
  return Done{};
}

Cage::Cage(CageParts parts) : parts_(std::move(parts)), digest_(digest_of(parts_)) {}

Result<Cage> Cage::create(CageParts parts) {
  const std::string field = "cage.control_vertices";
  if (Status s = check_positions(parts.control_vertices, parts.dimension, field); !s) return s.error();
  const size_t count = parts.control_vertices.size() / parts.dimension;
  if (count > std::numeric_limits<uint32_t>::max()) return input_error(field, "are more than 32 bits can count");
  if (Status s = check_elements(parts.segments, 2, count, "cage.segments"); !s) return s.error();
  if (Status s = check_elements(parts.triangles, 3, count, "cage.triangles"); !s) return s.error();
  if (Status s = check_elements(parts.quads, 4, count, "cage.quads"); !s) return s.error();
  if (Status s = check_faces(parts.polygons, count, "cage.polygons"); !s) return s.error();
  separate_polygons(parts);
  return Cage(std::move(parts));
}

}  // namespace barycast::client
