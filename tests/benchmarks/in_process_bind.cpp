// The same job as a request, without the service: in_process_bind JOB KIND SAMPLES REPEATS
//
// JOB is a file of remote_overhead.py. Prints the wall seconds of every repetition, a line each, from arrays to all
// rows, the cage's index being there already (as a server's cache has it). Gradients, denoising as the service does.

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "bind/binding.h"

namespace {

using barycast::CoordinateKind;

template <class T>
std::vector<T> read_array(std::FILE* file) {
  uint64_t count = 0;
  std::vector<T> values;
  if (std::fread(&count, sizeof count, 1, file) == 1) values.resize(count);
  if (std::fread(values.data(), sizeof(T), values.size(), file) != values.size()) std::abort();
  return values;
}

double run(const std::shared_ptr<const barycast::CageIndex>& index, barycast::QueryInput queries,
           const barycast::ResolvedOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  auto binding = barycast::Binding::create(index, std::move(queries), {.options = options});
  if (!binding) std::abort();
  std::vector<barycast::RowBlock> blocks;
  for (;;) {
    const auto step = (*binding)->advance(barycast::kNeverCancelled);
    if (step == barycast::Binding::Step::kBlock) blocks.push_back((*binding)->take_block());
    if (step == barycast::Binding::Step::kDone) break;
  }
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace

int main(int argc, char** argv) {
  std::FILE* const file = argc == 5 ? std::fopen(argv[1], "rb") : nullptr;
  if (file == nullptr) {
    std::fputs("usage: in_process_bind JOB harmonic|mean-value|positive-mean-value SAMPLES REPEATS\n", stderr);
    return 2;
  }
  const auto vertices = read_array<double>(file);
  const auto triangles = read_array<uint32_t>(file), quads = read_array<uint32_t>(file);
  const barycast::QueryInput queries{.points = read_array<double>(file),
                                     .face_offsets = read_array<uint32_t>(file),
                                     .face_corners = read_array<uint32_t>(file)};
  std::fclose(file);
  barycast::CageInput cage;
  cage.control_vertices = vertices;
  cage.triangles = triangles;
  cage.quads = quads;
  const auto index = barycast::CageIndex::create(cage);
  barycast::Options choices;
  const std::string kind = argv[2];
  choices.coordinates = kind == "harmonic"     ? CoordinateKind::kHarmonic
                        : kind == "mean-value" ? CoordinateKind::kMeanValue
                                               : CoordinateKind::kPositiveMeanValue;
  choices.samples = static_cast<uint32_t>(std::strtoul(argv[3], nullptr, 10));
  choices.gradients = true;
  const auto options = barycast::resolve(choices, queries.face_offsets.size() > 1);
  if (!index || !options) return 1;
  for (long i = std::strtol(argv[4], nullptr, 10); i > 0; --i) std::printf("%.4f\n", run(*index, queries, *options));
  return 0;
}
