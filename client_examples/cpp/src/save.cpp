#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <limits>
#include <memory>

#include "barycast/client/binding.h"
#include "npz_writer.h"

namespace barycast::client {
namespace {

namespace fs = std::filesystem;

Error cannot_write(const std::string& path, const std::string& why, Code code = Code::kInvalidArgument) {
  return input_error(path, "cannot be written: " + why, code);
}

// Where path leads, through links, if a file can be put there.
Result<fs::path> output_target(const std::string& path) {
  std::error_code failure;
  const fs::path target = fs::weakly_canonical(fs::absolute(path, failure), failure);
  if (failure) return cannot_write(path, failure.message());
  if (fs::exists(target, failure) && !fs::is_regular_file(target, failure)) {
    return cannot_write(path, "it exists and is no regular file");
  }
  const fs::path folder = target.parent_path();
  if (!fs::is_directory(folder, failure) || access(folder.c_str(), W_OK | X_OK) != 0) {
    return cannot_write(path, folder.string() + " is not a folder that you may write to");
  }
  return target;
}

template <class T>
std::span<const std::byte> bytes_of(const std::vector<T>& values) {
  return std::as_bytes(std::span(values));
}

void add_reals(NpzWriter& file, const std::string& name, const Reals& reals, uint64_t columns) {
  std::visit(
      [&](const auto& values) {
        const std::string type = sizeof(values[0]) == 4 ? "<f4" : "<f8";
        std::vector<uint64_t> shape = {values.size() / columns};
        if (columns > 1) shape.push_back(columns);
        file.add(name, type, shape, bytes_of(values));
      },
      reals);
}

// The keys of the Python client's Binding.save, in its order.
bool write(const Binding& binding, std::FILE* stream) {
  NpzWriter file(stream);
  const std::string format = "csr";
  file.add("format", "|S3", {}, std::as_bytes(std::span(format)));
  const std::vector<int64_t> shape = {static_cast<int64_t>(binding.point_count()),
                                      static_cast<int64_t>(binding.control_vertex_count())};
  file.add("shape", "<i8", {2}, bytes_of(shape));
  add_reals(file, "data", binding.values, 1);
  // scipy wants one signed type for both index arrays; control vertices are far below 2^31.
  const bool narrow = binding.indices.size() <= static_cast<size_t>(std::numeric_limits<int32_t>::max());
  std::vector<uint32_t> offsets32;
  std::vector<uint64_t> indices64;
  if (narrow) {
    offsets32.reserve(binding.offsets.size());
    for (const uint64_t offset : binding.offsets) offsets32.push_back(static_cast<uint32_t>(offset));
    file.add("indices", "<i4", {binding.indices.size()}, bytes_of(binding.indices));
    file.add("indptr", "<i4", {offsets32.size()}, bytes_of(offsets32));
  } else {
    indices64.assign(binding.indices.begin(), binding.indices.end());
    file.add("indices", "<i8", {indices64.size()}, bytes_of(indices64));
    file.add("indptr", "<i8", {binding.offsets.size()}, bytes_of(binding.offsets));
  }
  file.add("flags", "|u1", {binding.flags.size()}, bytes_of(binding.flags));
  file.add_text("cage_digest", binding.cage_digest);
  file.add_text("report", to_json(binding.report));
  if (binding.report.options.gradients) add_reals(file, "gradients", binding.gradients, binding.report.dimension);
  if (binding.report.options.errors) file.add("errors", "<f4", {binding.point_count(), 2}, bytes_of(binding.errors));
  return file.finish();
}

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};

}  // namespace

Status check_output(const std::string& path, const std::vector<std::string>& inputs) {
  // So that no mistyped name overwrites a model or a cage.
  if (fs::path(path).extension() != ".npz") return cannot_write(path, "must end in .npz", Code::kInvalidArgument);
  const Result<fs::path> target = output_target(path);
  if (!target) return target.error();
  for (const std::string& input : inputs) {
    std::error_code failure;
    if (!fs::equivalent(*target, input, failure) || failure) continue;
    return input_error(path, "would overwrite the input " + input + "; choose another name");
  }
  return Done{};
}

Status save(const Binding& binding, const std::string& path) {
  const Result<fs::path> target = output_target(path);
  if (!target) return target.error();
  // Beside the target, so that renaming cannot cross file systems.
  std::string name = ".";
  name.append(target->filename().string()).append(".").append(std::to_string(getpid())).append(".tmp");
  const fs::path temporary = target->parent_path() / name;
  const int descriptor = open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (descriptor < 0) return cannot_write(path, std::strerror(errno), Code::kUnknown);
  std::unique_ptr<std::FILE, CloseFile> file(fdopen(descriptor, "wb"));
  if (!file) close(descriptor);
  bool written = file && write(binding, file.get());
  int reason = errno;
  if (file && std::fclose(file.release()) != 0 && written) {
    written = false;
    reason = errno;
  }
  if (written && std::rename(temporary.c_str(), target->c_str()) == 0) return Done{};
  if (written) reason = errno;
  unlink(temporary.c_str());
  return cannot_write(path, std::strerror(reason), Code::kUnknown);
}

}  // namespace barycast::client
