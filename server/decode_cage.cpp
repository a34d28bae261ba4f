#include <fmt/format.h>

#include <cstring>

#include "decode.h"
#include "decode_array.h"

namespace barycast::server {
namespace {

Error unimplemented(std::string field, std::string message) {
  return {ErrorCode::kUnimplemented, std::move(field), std::move(message)};
}

bool has_rows(const v1::Array& array) {
  return array.rows() != 0 || !array.data().empty();
}

Status check_elements(const v1::Cage& cage, int dimension) {
  if (has_rows(cage.points())) {
    return unimplemented("cage.points", "isolated points are not built yet; leave them out");
  }
  const v1::Stencils& stencils = cage.stencils();
  if (has_rows(stencils.offsets()) || has_rows(stencils.vertices()) || has_rows(stencils.weights())) {
    return unimplemented("cage.stencils", "stencils are not built yet; send the corners as control vertices");
  }
  if (dimension == 3) {
    if (!has_rows(cage.segments())) return Done{};
    return unimplemented("cage.segments",
                         "curve networks in space are not built yet; send triangles, quads or polygons");
  }
  const char* wrong = has_rows(cage.triangles())                                                   ? "cage.triangles"
                      : has_rows(cage.quads())                                                     ? "cage.quads"
                      : has_rows(cage.polygons().offsets()) || has_rows(cage.polygons().corners()) ? "cage.polygons"
                                                                                                   : nullptr;
  if (wrong == nullptr) return Done{};
  return invalid_argument(wrong, "a cage in the plane has segments only; send the edges of its outline");
}

// Offsets must be safe to follow before anything walks along them.
Status check_polygons(const CageStorage& storage) {
  const std::vector<uint32_t>& offsets = storage.polygon_offsets;
  const uint64_t corners = storage.polygon_corners.size();
  if (offsets.empty()) {
    if (corners == 0) return Done{};
    return invalid_argument("cage.polygons.offsets", fmt::format("missing, for {} corners", corners));
  }
  if (offsets.front() != 0) {
    return invalid_argument("cage.polygons.offsets[0]", fmt::format("{}, expected 0", offsets.front()));
  }
  for (size_t i = 1; i < offsets.size(); ++i) {
    if (offsets[i] < offsets[i - 1] || offsets[i] - offsets[i - 1] < 3) {
      return invalid_argument(
          fmt::format("cage.polygons[{}]", i - 1),
          fmt::format("offsets {} to {}; a polygon has 3 or more corners", offsets[i - 1], offsets[i]));
    }
  }
  if (offsets.back() != corners) {
    return invalid_argument(fmt::format("cage.polygons.offsets[{}]", offsets.size() - 1),
                            fmt::format("{}, expected the number of corners, {}", offsets.back(), corners));
  }
  return Done{};
}

Status copy_elements(const v1::Cage& cage, CageStorage& storage) {
  if (Status s = append_uint32(cage.segments(), 2, "cage.segments", storage.segments); !s) return s;
  if (Status s = append_uint32(cage.triangles(), 3, "cage.triangles", storage.triangles); !s) return s;
  if (Status s = append_uint32(cage.quads(), 4, "cage.quads", storage.quads); !s) return s;
  const v1::Polygons& polygons = cage.polygons();
  if (Status s = append_uint32(polygons.offsets(), 1, "cage.polygons.offsets", storage.polygon_offsets); !s) return s;
  if (Status s = append_uint32(polygons.corners(), 1, "cage.polygons.corners", storage.polygon_corners); !s) return s;
  // No polygons, said in one offset or in none: one form from here on, so that both have one digest.
  if (storage.polygon_offsets.size() == 1 && storage.polygon_offsets[0] == 0 && storage.polygon_corners.empty()) {
    storage.polygon_offsets.clear();
  }
  return check_polygons(storage);
}

}  // namespace

uint64_t CageStorage::stencil_max() const {
  uint64_t result = 4;
  for (size_t i = 0; i + 1 < polygon_offsets.size(); ++i) {
    if (polygon_offsets[i + 1] > polygon_offsets[i])
      result = std::max<uint64_t>(result, polygon_offsets[i + 1] - polygon_offsets[i]);
  }
  return result;
}

uint64_t CageStorage::element_count() const {
  uint64_t count = segments.size() / 2 + triangles.size() / 3 + quads.size() / 4;
  for (size_t i = 0; i + 1 < polygon_offsets.size(); ++i) {
    const uint32_t corners = polygon_offsets[i + 1] - polygon_offsets[i];
    count += corners <= 4 ? 1 : corners;
  }
  return count;
}

CageInput CageStorage::input() const {
  return {.dimension = dimension,
          .control_vertices = control_vertices,
          .segments = segments,
          .triangles = triangles,
          .quads = quads,
          .polygon_offsets = polygon_offsets,
          .polygon_corners = polygon_corners};
}

Result<CageStorage> decode_cage(const v1::Cage& cage, const Limits& limits) {
  const v1::Array& vertices = cage.control_vertices();
  if (!has_rows(vertices)) return invalid_argument("cage.control_vertices", "none; a cage needs control vertices");
  if (vertices.columns() != 2 && vertices.columns() != 3) {
    return invalid_argument("cage.control_vertices.columns",
                            fmt::format("{}, expected 2 or 3, the dimension of space", vertices.columns()));
  }
  CageStorage storage;
  storage.dimension = static_cast<int>(vertices.columns());
  if (Status s = check_elements(cage, storage.dimension); !s) return s.error();
  if (Status s = append_float(vertices, 0, "cage.control_vertices", storage.control_vertices); !s) return s.error();
  if (Status s = copy_elements(cage, storage); !s) return s.error();
  if (const uint64_t size = canonical_size_bytes(storage.input()); size > limits.cage_bytes_max) {
    return Error{ErrorCode::kResourceExhausted, "cage",
                 fmt::format("{} canonical bytes, more than this server's limit of {}; use a coarser cage", size,
                             limits.cage_bytes_max)};
  }
  return storage;
}

Result<CageStorage> decode_cage_bytes(const std::string& bytes, const Limits& limits) {
  v1::Cage cage;
  if (!cage.ParseFromString(bytes)) {
    return invalid_argument("cage", fmt::format("the {} uploaded bytes are no serialized Cage message", bytes.size()));
  }
  return decode_cage(cage, limits);
}

Result<CageDigest> decode_digest(const v1::CageDigest& digest, const std::string& path) {
  CageDigest result;
  if (digest.sha256().size() != result.sha256.size()) {
    return invalid_argument(path + ".sha256",
                            fmt::format("{} bytes, expected {}", digest.sha256().size(), result.sha256.size()));
  }
  if (digest.size_bytes() == 0) return invalid_argument(path + ".size_bytes", "0; state the number of canonical bytes");
  std::memcpy(result.sha256.data(), digest.sha256().data(), result.sha256.size());
  result.size_bytes = digest.size_bytes();
  return result;
}

Result<std::vector<CageDigest>> decode_digests(const v1::FindMissingCagesRequest& request, const Limits& limits) {
  if (static_cast<uint64_t>(request.digests_size()) > limits.digests_max) {
    return invalid_argument("digests", fmt::format("{}, more than this server's limit of {}; ask in several requests",
                                                   request.digests_size(), limits.digests_max));
  }
  std::vector<CageDigest> result;
  for (int i = 0; i < request.digests_size(); ++i) {
    Result<CageDigest> digest = decode_digest(request.digests(i), fmt::format("digests[{}]", i));
    if (!digest) return digest.error();
    result.push_back(*digest);
  }
  return result;
}

}  // namespace barycast::server
