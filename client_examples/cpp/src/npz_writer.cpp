#include "npz_writer.h"

#include <zlib.h>

#include <bit>

namespace barycast::client {
namespace {

static_assert(std::endian::native == std::endian::little, "arrays and archives are little-endian");

// Records of the zip format (PKWARE's APPNOTE, sections 4.3 and 4.5).
constexpr uint32_t kLocal = 0x04034b50, kCentral = 0x02014b50, kEnd = 0x06054b50;
constexpr uint32_t kEnd64 = 0x06064b50, kLocator64 = 0x07064b50;
constexpr uint16_t kVersion64 = 45;  // the first that knows 64-bit sizes
constexpr uint16_t kExtra64 = 1;     // the extra field that holds them
constexpr uint16_t kDate1980 = 1 << 5 | 1;
constexpr uint32_t kSee64 = 0xffffffff;  // "the size is in the extra field"

class Record {
 public:
  template <class... Integers>
  explicit Record(Integers... integers) {
    (add(integers), ...);
  }
  template <class Integer>
  void add(Integer value) {
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
};

std::span<const std::byte> bytes_of(const std::string& text) {
  return std::as_bytes(std::span(text));
}

uint32_t crc(uint32_t start, std::span<const std::byte> data) {
  return static_cast<uint32_t>(crc32_z(start, reinterpret_cast<const Bytef*>(data.data()), data.size()));
}

// numpy's format 1.0: the data starts at a multiple of 64 bytes.
std::string npy_header(const std::string& type, const std::vector<uint64_t>& shape) {
  std::string tuple;
  for (const uint64_t extent : shape) tuple += std::to_string(extent) + ",";
  if (shape.size() > 1) tuple.pop_back();
  std::string text = "{'descr': '" + type + "', 'fortran_order': False, 'shape': (" + tuple + "), }";
  constexpr size_t kPrefix = 10;
  text.append(63 - (kPrefix + text.size()) % 64, ' ');
  text += '\n';
  const auto length = static_cast<uint16_t>(text.size());
  return std::string("\x93NUMPY\x01\x00", 8) + Record(length).bytes() + text;
}

// What local and central headers share: version needed, flags, method (stored), time, date, CRC, sizes, name length.
Record entry_fields(uint32_t crc, size_t name_bytes) {
  return Record(kVersion64, uint16_t{0}, uint16_t{0}, uint16_t{0}, kDate1980, crc, kSee64, kSee64,
                static_cast<uint16_t>(name_bytes));
}

}  // namespace

void NpzWriter::write(std::span<const std::byte> data) {
  ok_ = ok_ && std::fwrite(data.data(), 1, data.size(), file_) == data.size();
  written_ += data.size();
}

void NpzWriter::write(const std::string& data) {
  write(bytes_of(data));
}

void NpzWriter::add(const std::string& name, const std::string& type, const std::vector<uint64_t>& shape,
                    std::span<const std::byte> data) {
  const std::string header = npy_header(type, shape);
  const Entry entry{name + ".npy", crc(crc(0, bytes_of(header)), data), header.size() + data.size(), written_};
  Record local(kLocal);
  Record extra(kExtra64, uint16_t{16}, entry.bytes, entry.bytes);
  write(local.bytes() + entry_fields(entry.crc, entry.name.size()).bytes() +
        Record(static_cast<uint16_t>(extra.bytes().size())).bytes() + entry.name + extra.bytes());
  write(header);
  write(data);
  entries_.push_back(entry);
}

void NpzWriter::add_text(const std::string& name, const std::string& text) {
  const std::u32string wide(text.begin(), text.end());
  add(name, "<U" + std::to_string(text.size()), {}, std::as_bytes(std::span(wide)));
}

bool NpzWriter::finish() {
  const uint64_t begin = written_;
  for (const Entry& entry : entries_) {
    const Record extra(kExtra64, uint16_t{24}, entry.bytes, entry.bytes, entry.begin);
    write(
        Record(kCentral, kVersion64).bytes() + entry_fields(entry.crc, entry.name.size()).bytes() +
        Record(static_cast<uint16_t>(extra.bytes().size()), uint16_t{0}, uint16_t{0}, uint16_t{0}, uint32_t{0}, kSee64)
            .bytes() +
        entry.name + extra.bytes());
  }
  const uint64_t size = written_ - begin, end64 = written_;
  const auto count = static_cast<uint64_t>(entries_.size());
  write(Record(kEnd64, uint64_t{44}, kVersion64, kVersion64, uint32_t{0}, uint32_t{0}, count, count, size, begin)
            .bytes());
  write(Record(kLocator64, uint32_t{0}, end64, uint32_t{1}).bytes());
  constexpr uint16_t kSee64Count = 0xffff;
  write(Record(kEnd, uint16_t{0}, uint16_t{0}, kSee64Count, kSee64Count, kSee64, kSee64, uint16_t{0}).bytes());
  return ok_ && std::fflush(file_) == 0;
}

}  // namespace barycast::client
