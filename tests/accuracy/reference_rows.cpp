// Rows by the reference instruments: reference_rows JOB METHOD ARGUMENT OUTPUT
//
// JOB is a file of tests/accuracy/references.py: a count (u64) and the data of each of control vertices (f8, 3 a
// vertex), triangles (u4), quads (u4) and points (f8). OUTPUT gets points x control vertices little-endian float64, not
// a number where a method has no row. Prints a line of what it took. METHOD and ARGUMENT:
//   positive DIRECTIONS    positive mean value coordinates by brute-force visibility
//   volumetric RESOLUTION  harmonic coordinates on a grid
//   harmonic_gradients WALKS  of harmonic coordinates inside a closed cage, near it: points x 3 control vertices
//   mean_value 0           mean value coordinates of a closed cage by quadrature, for points off it

#include <sys/resource.h>

#include <bit>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>
#include <string_view>

#include "base/parallel.h"
#include "support/harmonic_gradients.h"
#include "support/mean_value_quadrature.h"
#include "support/positive_mean_value.h"
#include "support/volumetric_harmonic.h"

namespace {

using barycast::Cage;
using barycast::testing::DenseRows;

struct Job {
  std::vector<double> vertices;
  std::vector<uint32_t> triangles, quads;
  std::vector<double> points;
};

template <class T>
bool read_array(std::FILE* file, std::vector<T>& values) {
  uint64_t count = 0;
  // A job of more than 2^32 values is a file of another kind.
  if (std::fread(&count, sizeof count, 1, file) != 1 || count > UINT32_MAX) return false;
  values.resize(count);
  return std::fread(values.data(), sizeof(T), count, file) == count;
}

std::optional<Job> read_job(const char* path) {
  std::FILE* const file = std::fopen(path, "rb");
  if (file == nullptr) return std::nullopt;
  Job job;
  const bool read = read_array(file, job.vertices) && read_array(file, job.triangles) && read_array(file, job.quads) &&
                    read_array(file, job.points) && job.points.size() % 3 == 0;
  std::fclose(file);
  return read ? std::optional(std::move(job)) : std::nullopt;
}

bool write_rows(const char* path, const DenseRows& rows) {
  static_assert(std::endian::native == std::endian::little);
  std::FILE* const file = std::fopen(path, "wb");
  if (file == nullptr) return false;
  const auto count = static_cast<size_t>(rows.size());
  const bool written = std::fwrite(rows.data(), sizeof(double), count, file) == count;
  return std::fclose(file) == 0 && written;
}

struct Method {
  std::string_view name;
  DenseRows (*rows)(const Cage<3>& cage, std::span<const double> points, int argument);
  int argument_min;
};

constexpr Method kMethods[] = {
    {"positive",
     [](const Cage<3>& cage, std::span<const double> points, int directions) {
       return barycast::testing::positive_mean_value(cage, points, static_cast<size_t>(directions));
     },
     8},
    {"volumetric",
     [](const Cage<3>& cage, std::span<const double> points, int resolution) {
       return barycast::testing::VolumetricHarmonic(cage, resolution).evaluate(points);
     },
     4},
    {"harmonic_gradients",
     [](const Cage<3>& cage, std::span<const double> points, int walks) {
       return barycast::testing::harmonic_gradients(cage, points, static_cast<uint32_t>(walks));
     },
     8},
    {"mean_value",
     [](const Cage<3>& cage, std::span<const double> points, int) {
       const barycast::testing::MeanValueQuadrature quadrature(cage);
       DenseRows rows(static_cast<Eigen::Index>(points.size() / 3), cage.control_vertex_count());
       barycast::parallel_for(points.size() / 3, 1, [&](size_t begin, size_t end) {
         for (size_t i = begin; i < end; ++i) {
           const std::vector<double> row = quadrature(barycast::testing::normalized_point(cage, points, i));
           rows.row(static_cast<Eigen::Index>(i)) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), rows.cols());
         }
       });
       return rows;
     },
     0},
};

const Method* find_method(std::string_view name) {
  for (const Method& method : kMethods)
    if (method.name == name) return &method;
  return nullptr;
}

int fail(const std::string& why) {
  std::fprintf(stderr, "reference_rows: %s\n", why.c_str());
  return 1;
}

}  // namespace

int main(int argc, char** argv) {
  const Method* const method = argc == 5 ? find_method(argv[2]) : nullptr;
  const int argument = argc == 5 ? std::atoi(argv[3]) : 0;
  if (method == nullptr || argument < method->argument_min) {
    std::fputs("usage: reference_rows JOB METHOD ARGUMENT OUTPUT; methods and the least argument of each:\n", stderr);
    for (const Method& known : kMethods) std::fprintf(stderr, "  %s %d\n", known.name.data(), known.argument_min);
    return 2;
  }
  const auto job = read_job(argv[1]);
  if (!job) return fail(std::string(argv[1]) + " is not a job");
  barycast::CageInput input;
  input.control_vertices = job->vertices;
  input.triangles = job->triangles;
  input.quads = job->quads;
  const auto cage = Cage<3>::create(input);
  if (!cage) return fail(cage.error().text());

  const auto start = std::chrono::steady_clock::now();
  const DenseRows rows = method->rows(*cage, job->points, argument);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  if (!write_rows(argv[4], rows)) return fail(std::string("cannot write ") + argv[4]);
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  std::printf("%s %d: %ld rows of %ld, %ld not a number, %.2f s, at most %.0f MB\n", argv[2], argument,
              static_cast<long>(rows.rows()), static_cast<long>(rows.cols()),
              static_cast<long>(rows.rowwise().sum().array().isNaN().count()), seconds,
              static_cast<double>(usage.ru_maxrss) / 1024);
  return 0;
}
