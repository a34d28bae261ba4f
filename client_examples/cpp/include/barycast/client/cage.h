#pragma once

// Cages: control vertices in R^2 or R^3, in the caller's units, and the elements between them; and the
// digest that names a cage, SHA-256 over the canonical bytes that barycast/v1/cage.proto defines.
// Positions are row-major (x, y, z, x, y, z, ...), indices count from 0. Cage::create checks shapes,
// indices and finiteness, and is the only door; whether the elements span space is the server's to say.
// A Cage is immutable and may be read from any number of threads. Cost: one copy and one hash.

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "barycast/client/result.h"

namespace barycast::client {

// Faces of any size: face i has the corners corners[offsets[i]] ... corners[offsets[i + 1] - 1].
struct Faces {
  std::vector<uint64_t> offsets = {0};
  std::vector<uint32_t> corners;

  size_t size() const { return offsets.empty() ? 0 : offsets.size() - 1; }
  std::span<const uint32_t> face(size_t i) const {
    return std::span(corners).subspan(offsets[i], offsets[i + 1] - offsets[i]);
  }
  void add(std::span<const uint32_t> face_corners) {
    corners.insert(corners.end(), face_corners.begin(), face_corners.end());
    offsets.push_back(corners.size());
  }
};

// Checks that faces fit together, have three or more corners, and name vertices below vertex_count; `field` is how
// errors name the list.
Status check_faces(const Faces& faces, size_t vertex_count, const std::string& field);

struct CageParts {
  std::vector<double> control_vertices;  // n x dimension, finite
  uint32_t dimension = 3;                // 2 or 3
  std::vector<uint32_t> segments = {};   // k x 2
  std::vector<uint32_t> triangles = {};  // k x 3, R^3 only
  std::vector<uint32_t> quads = {};      // k x 4, R^3 only: bilinear patches, corners in cyclic order
  Faces polygons = {};                   // R^3 only
};

struct CageDigest {
  std::array<uint8_t, 32> sha256 = {};
  uint64_t size_bytes = 0;

  std::string hexadecimal() const;
  bool operator==(const CageDigest&) const = default;
};

class Cage {
 public:
  // Polygons of three and four corners are moved behind the triangles and quads, which is what they are: so one
  // surface has one digest however it was listed, and the same one as from the Python client.
  static Result<Cage> create(CageParts parts);

  const CageParts& parts() const { return parts_; }
  const CageDigest& digest() const { return digest_; }
  uint32_t dimension() const { return parts_.dimension; }
  size_t control_vertex_count() const { return parts_.control_vertices.size() / parts_.dimension; }

 private:
  explicit Cage(CageParts parts);

  CageParts parts_;
  CageDigest digest_;
};

}  // namespace barycast::client
