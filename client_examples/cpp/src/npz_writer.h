#pragma once

// Writes numpy's .npz: a zip archive of .npy arrays, stored without compression, dates left at 1980 so
// that equal arrays give equal files. All sizes are in the 64-bit form, as numpy's own writer does.
// The arrays are borrowed until `finish`. Errors of the file are kept and told by `finish`.

#include <cstdint>
#include <cstdio>
#include <span>
#include <string>
#include <vector>

namespace barycast::client {

class NpzWriter {
 public:
  explicit NpzWriter(std::FILE* file) : file_(file) {}

  // One array: its numpy type ("<f4"), shape, and entries in C order.
  void add(const std::string& name, const std::string& type, const std::vector<uint64_t>& shape,
           std::span<const std::byte> data);
  // A string of ASCII characters, as numpy keeps them (4 bytes each).
  void add_text(const std::string& name, const std::string& text);

  // Writes the archive's directory and returns whether everything was written.
  bool finish();

 private:
  struct Entry {
    std::string name;
    uint32_t crc;
    uint64_t bytes;
    uint64_t begin;
  };

  void write(std::span<const std::byte> data);
  void write(const std::string& data);

  std::FILE* file_;
  bool ok_ = true;
  uint64_t written_ = 0;
  std::vector<Entry> entries_;
};

}  // namespace barycast::client
