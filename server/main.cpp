// barycastd: the daemon. This file is compiled for the x86-64 baseline, so that it can say in a sentence
// that the processor is too old; everything that it calls after that needs x86-64-v3.

#include <cstdio>

#include "run.h"

namespace {

bool has_baseline() {
  __builtin_cpu_init();
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
         __builtin_cpu_supports("bmi2");
}

}  // namespace

int main(int argc, char** argv) {
  if (!has_baseline()) {
    std::fputs("barycastd: this processor lacks AVX2, FMA or BMI (x86-64-v3); run it on one from 2015 or later.\n",
               stderr);
    return 1;
  }
  return barycast::server::run(argc, argv);
}
