#include "request_blocks.h"

#include <algorithm>

namespace barycast::client {
namespace {

constexpr uint64_t kBlockItems = 65536;        // points or faces of one message: 1.5 MiB of double points
constexpr uint64_t kMessageBytesSpare = 4096;  // for the fields around an array

uint64_t room(uint64_t message_bytes_max) {
  return message_bytes_max > kMessageBytesSpare ? message_bytes_max - kMessageBytesSpare : 1;
}

}  // namespace

bool send_points(const Points& points, uint64_t message_bytes_max, const SendMessage& send) {
  const auto send_all = [&](const auto& values) {
    const uint64_t point_bytes = points.dimension * sizeof(values[0]);
    const uint64_t step = std::clamp<uint64_t>(room(message_bytes_max) / point_bytes, 1, kBlockItems);
    for (uint64_t begin = 0; begin < points.size(); begin += step) {
      const uint64_t count = std::min(step, points.size() - begin);
      v1::ComputeCoordinatesRequest message;
      set_array(*message.mutable_points()->mutable_points(),
                values.subspan(begin * points.dimension, count * points.dimension), points.dimension);
      if (!send(message)) return false;
    }
    return true;
  };
  return std::visit(send_all, points.values);
}

bool send_faces(const Faces& faces, uint64_t message_bytes_max, const SendMessage& send) {
  const uint64_t words_max = room(message_bytes_max) / sizeof(uint32_t);  // a face takes its corners and its count
  std::vector<uint32_t> counts;
  for (uint64_t begin = 0, end = 0; begin < faces.size(); begin = end) {
    counts.clear();
    uint64_t words = 0;
    for (end = begin; end < faces.size() && counts.size() < kBlockItems; ++end) {
      const uint64_t corners = faces.offsets[end + 1] - faces.offsets[end];
      if (end > begin && words + corners + 1 > words_max) break;
      words += corners + 1;
      counts.push_back(static_cast<uint32_t>(corners));
    }
    v1::ComputeCoordinatesRequest message;
    set_array(*message.mutable_faces()->mutable_corner_counts(), std::span<const uint32_t>(counts));
    set_array(*message.mutable_faces()->mutable_corners(),
              std::span(faces.corners).subspan(faces.offsets[begin], faces.offsets[end] - faces.offsets[begin]));
    if (!send(message)) return false;
  }
  return true;
}

}  // namespace barycast::client
