// Says in a sentence that the processor is too old, before anything runs that it does not know. Our objects need
// x86-64-v3 from their static initialisers on, and initialisers of shared libraries may call inline functions of ours;
// so this runs from .preinit_array, ahead of all of them. It is compiled for the x86-64 baseline, and uses no inline
// function of others: the linker might take the copy of an object that is not.

#include <cpuid.h>
#include <unistd.h>

namespace {

// Not 1: starting again does not help. Stated in deploy/README.md.
constexpr int kExitProcessor = 3;

constexpr char kTooOld[] =
    "barycastd: this processor lacks AVX2, FMA or BMI (x86-64-v3), or a hypervisor hides them; run it on one from 2015 "
    "or later.\n";

// Sanitizers are not ready this early.
#define BARYCAST_EARLY __attribute__((no_sanitize("address", "undefined")))

BARYCAST_EARLY bool has(unsigned found, unsigned needed) {
  return (found & needed) == needed;
}

BARYCAST_EARLY bool is_v3() {
  unsigned a = 0, b = 0, c = 0, d = 0;
  if (__get_cpuid(1, &a, &b, &c, &d) == 0) return false;
  if (!has(c, bit_FMA | bit_MOVBE | bit_OSXSAVE | bit_AVX | bit_F16C)) return false;
  unsigned kept = 0, high = 0;
  asm volatile("xgetbv" : "=a"(kept), "=d"(high) : "c"(0));
  if (!has(kept, 6)) return false;  // the system must save SSE's and AVX's registers
  if (__get_cpuid_count(7, 0, &a, &b, &c, &d) == 0 || !has(b, bit_AVX2 | bit_BMI | bit_BMI2)) return false;
  return __get_cpuid(0x80000001, &a, &b, &c, &d) != 0 && has(c, bit_LZCNT);
}

BARYCAST_EARLY void check_processor() {
  if (is_v3()) return;
  // Where nobody reads standard error, the exit code still says it.
  [[maybe_unused]] const ssize_t written = write(STDERR_FILENO, kTooOld, sizeof kTooOld - 1);
  _exit(kExitProcessor);
}

__attribute__((section(".preinit_array"), used)) void (*const run_first)() = check_processor;

}  // namespace
