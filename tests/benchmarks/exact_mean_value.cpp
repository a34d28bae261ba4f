// Microseconds per point of mean value coordinates in closed form: exact_mean_value [TRIANGLES]
//
// On a sphere of about so many triangles (92 unless given), at some points inside, on one core: the median, the least
// and the most of 31 repetitions, for values and with gradients.

#include <time.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <random>

#include "solve/exact_mean_value.h"
#include "support/mean_value.h"

// Of the processor, so that other programs' turns do not count.
double thread_seconds() {
  timespec time;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

int main(int argc, char** argv) {
  using barycast::Vec;
  const double wanted = argc > 1 ? std::strtod(argv[1], nullptr) : 92.0;
  // n x 2n quads make 4 n (n - 1) triangles.
  const int n = std::max(2, static_cast<int>(std::lround((1 + std::sqrt(1 + wanted)) / 2)));
  const auto shape = barycast::testing::triangulated(barycast::testing::sphere(n, 1.0));
  const auto cage = barycast::Cage<3>::create(shape.input());
  if (!cage) return 1;
  const auto solution = barycast::ExactMeanValue::create(*cage);
  if (!solution) return 1;
  std::mt19937_64 generator(1);
  std::uniform_real_distribution<double> uniform(-0.4, 0.4);
  std::vector<Vec<3>> points(std::max<size_t>(16, 400000 / cage->elements().size()));
  for (Vec<3>& x : points) x = Vec<3>(uniform(generator), uniform(generator), uniform(generator));
  std::printf("%zu triangles, %u control vertices\n", cage->elements().size(), cage->control_vertex_count());
  barycast::SolvedRows<3> rows;
  for (const bool gradients : {false, true}) {
    std::vector<double> microseconds;
    for (int repeat = 0; repeat < 31; ++repeat) {
      const double start = thread_seconds();
      (*solution)->evaluate(points, gradients, rows);
      microseconds.push_back(1e6 * (thread_seconds() - start) / static_cast<double>(points.size()));
    }
    std::sort(microseconds.begin(), microseconds.end());
    std::printf("%s: %.2f us per point (%.2f to %.2f)\n", gradients ? "values and gradients" : "values",
                microseconds[microseconds.size() / 2], microseconds.front(), microseconds.back());
  }
  return 0;
}
