#include "decode_array.h"

#include <fmt/format.h>

#include <bit>
#include <cstring>
#include <limits>

namespace barycast::server {
namespace {

static_assert(std::endian::native == std::endian::little, "arrays are little-endian and copied as they are");

uint64_t entry_bytes(v1::DataType type) {
  return type == v1::DATA_TYPE_FLOAT64 ? 8 : 4;
}

std::string type_name(v1::DataType type) {
  return v1::DataType_IsValid(type) ? v1::DataType_Name(type) : fmt::format("unknown type {}", static_cast<int>(type));
}

// An Array that was never filled in counts as no rows.
bool is_empty(const v1::Array& array) {
  return array.rows() == 0 && array.data().empty();
}

Status check_shape(const v1::Array& array, uint32_t columns, const std::string& path) {
  if (columns != 0 && array.columns() != columns) {
    return invalid_argument(path + ".columns", fmt::format("{}, expected {}", array.columns(), columns));
  }
  const uint64_t row_bytes = array.columns() * entry_bytes(array.type());
  if (row_bytes == 0) return invalid_argument(path + ".columns", "0; state the number of columns");
  if (array.rows() > std::numeric_limits<uint64_t>::max() / row_bytes) {
    return invalid_argument(path + ".rows", fmt::format("{} rows do not fit any message", array.rows()));
  }
  if (array.data().size() != array.rows() * row_bytes) {
    return invalid_argument(
        path + ".data", fmt::format("{} bytes, expected {} ({} x {} {})", array.data().size(), array.rows() * row_bytes,
                                    array.rows(), array.columns(), type_name(array.type())));
  }
  return Done{};
}

// Grows at least geometrically, as push_back would; a bulk resize alone would copy once per block.
template <class T>
T* extend(std::vector<T>& out, size_t count) {
  const size_t before = out.size();
  if (out.capacity() < before + count) out.reserve(std::max(before + count, before * 2));
  out.resize(before + count);
  return out.data() + before;
}

}  // namespace

Status append_uint32(const v1::Array& array, uint32_t columns, const std::string& path, std::vector<uint32_t>& out) {
  if (is_empty(array)) return Done{};
  if (array.type() != v1::DATA_TYPE_UINT32) {
    return invalid_argument(path + ".type", type_name(array.type()) + ", expected DATA_TYPE_UINT32");
  }
  if (Status shape = check_shape(array, columns, path); !shape) return shape;
  std::memcpy(extend(out, array.data().size() / 4), array.data().data(), array.data().size());
  return Done{};
}

Status append_float(const v1::Array& array, uint32_t columns, const std::string& path, std::vector<double>& out) {
  if (is_empty(array)) return Done{};
  if (array.type() != v1::DATA_TYPE_FLOAT32 && array.type() != v1::DATA_TYPE_FLOAT64) {
    return invalid_argument(path + ".type",
                            type_name(array.type()) + ", expected DATA_TYPE_FLOAT32 or DATA_TYPE_FLOAT64");
  }
  if (Status shape = check_shape(array, columns, path); !shape) return shape;
  const char* bytes = array.data().data();
  if (array.type() == v1::DATA_TYPE_FLOAT64) {
    std::memcpy(extend(out, array.data().size() / 8), bytes, array.data().size());
    return Done{};
  }
  const size_t count = array.data().size() / 4;
  double* to = extend(out, count);
  for (size_t i = 0; i < count; ++i) {
    float value;
    std::memcpy(&value, bytes + 4 * i, 4);
    to[i] = static_cast<double>(value);
  }
  return Done{};
}

}  // namespace barycast::server
