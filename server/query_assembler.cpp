#include "query_assembler.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "decode_array.h"

namespace barycast::server {
namespace {

Error too_many(const char* field, uint64_t count, uint64_t announced, const char* announced_field) {
  return invalid_argument(field,
                          fmt::format("{} so far, but header.queries.{} is {}", count, announced_field, announced));
}

Error too_few(const char* field, uint64_t count, uint64_t announced, const char* announced_field) {
  return invalid_argument(field,
                          fmt::format("{} in all, but header.queries.{} is {}", count, announced_field, announced));
}

// Grows by doubling, but never beyond what was announced: memory stays what admission was told. `needed` is what has
// arrived, so that an announcement alone takes nothing.
template <class T>
void make_room(std::vector<T>& list, uint64_t needed, uint64_t announced) {
  if (needed <= list.capacity()) return;
  list.reserve(std::max(needed, std::min<uint64_t>(announced, 2 * list.capacity())));
}

}  // namespace

Status QueryAssembler::add(const v1::PointBlock& block) {
  const auto dimension = static_cast<uint64_t>(dimension_);
  const uint64_t before = queries_.points.size() / dimension;
  if (block.points().rows() > announced_.points - before) {
    return too_many("points.points.rows", before + block.points().rows(), announced_.points, "point_count");
  }
  const uint64_t scalar = block.points().type() == v1::DATA_TYPE_FLOAT32 ? sizeof(float) : sizeof(double);
  make_room(queries_.points, queries_.points.size() + block.points().data().size() / scalar,
            announced_.points * dimension);
  if (Status s = append_float(block.points(), static_cast<uint32_t>(dimension_), "points.points", queries_.points);
      !s) {
    return s;
  }
  for (size_t i = before * dimension; i < queries_.points.size(); ++i) {
    if (!std::isfinite(queries_.points[i])) {
      return invalid_argument(fmt::format("points[{}]", i / dimension), "a coordinate is not finite; remove the point");
    }
  }
  return Done{};
}

Status QueryAssembler::add(const v1::FaceBlock& block) {
  const uint64_t faces = queries_.face_offsets.empty() ? 0 : queries_.face_offsets.size() - 1;
  if (block.corner_counts().rows() > announced_.faces - faces) {
    return too_many("faces.corner_counts.rows", faces + block.corner_counts().rows(), announced_.faces, "face_count");
  }
  if (block.corners().rows() > announced_.corners - queries_.face_corners.size()) {
    return too_many("faces.corners.rows", queries_.face_corners.size() + block.corners().rows(), announced_.corners,
                    "corner_count");
  }
  std::vector<uint32_t> counts, corners;
  if (Status s = append_uint32(block.corner_counts(), 1, "faces.corner_counts", counts); !s) return s;
  if (Status s = append_uint32(block.corners(), 1, "faces.corners", corners); !s) return s;
  return append_faces(counts, corners);
}

Status QueryAssembler::append_faces(const std::vector<uint32_t>& counts, const std::vector<uint32_t>& corners) {
  std::vector<uint32_t>& offsets = queries_.face_offsets;
  make_room(offsets, offsets.size() + counts.size() + 1, announced_.faces + 1);
  make_room(queries_.face_corners, queries_.face_corners.size() + corners.size(), announced_.corners);
  if (offsets.empty() && !counts.empty()) offsets.push_back(0);
  size_t next = 0;
  for (uint32_t count : counts) {
    const auto face = [&] { return fmt::format("faces[{}]", offsets.size() - 1); };
    if (count < 3) return invalid_argument(face(), fmt::format("{} corners; a face has 3 or more", count));
    if (count > corners.size() - next) {
      return invalid_argument("faces.corners.rows",
                              fmt::format("{}, fewer than faces.corner_counts add up to", corners.size()));
    }
    for (uint32_t i = 0; i < count; ++i) {
      if (corners[next + i] >= announced_.points) {
        return invalid_argument(fmt::format("{}.corner[{}]", face(), i),
                                fmt::format("index {} >= {} query points", corners[next + i], announced_.points));
      }
    }
    next += count;
    // Cannot overflow: the announced corner count fits 32 bits and bounds what arrives.
    offsets.push_back(offsets.back() + count);
  }
  if (next != corners.size()) {
    return invalid_argument("faces.corners.rows",
                            fmt::format("{}, but faces.corner_counts add up to {}", corners.size(), next));
  }
  queries_.face_corners.insert(queries_.face_corners.end(), corners.begin(), corners.end());
  return Done{};
}

Result<QueryInput> QueryAssembler::take() {
  const uint64_t points = queries_.points.size() / static_cast<uint64_t>(dimension_);
  if (points != announced_.points) return too_few("points", points, announced_.points, "point_count");
  const uint64_t faces = queries_.face_offsets.empty() ? 0 : queries_.face_offsets.size() - 1;
  if (faces != announced_.faces) return too_few("faces", faces, announced_.faces, "face_count");
  if (queries_.face_corners.size() != announced_.corners) {
    return too_few("faces.corners", queries_.face_corners.size(), announced_.corners, "corner_count");
  }
  return std::exchange(queries_, {});
}

}  // namespace barycast::server
