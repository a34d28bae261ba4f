#include "counted_malloc.h"

#include <malloc.h>

#include <atomic>
#include <cerrno>
#include <cstddef>

// glibc's own names of what is replaced below; operator new and Eigen come here through malloc.
extern "C" {
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);
void __libc_free(void*);
}

namespace {

constinit std::atomic<uint64_t> in_use = 0, in_use_max = 0;

// A chunk's header takes 8 bytes beside what may be used of it.
uint64_t chunk_bytes(void* p) {
  return p == nullptr ? 0 : malloc_usable_size(p) + 8;
}

void* added(void* p) {
  const uint64_t now = in_use.fetch_add(chunk_bytes(p), std::memory_order_relaxed) + chunk_bytes(p);
  uint64_t most = in_use_max.load(std::memory_order_relaxed);
  while (now > most && !in_use_max.compare_exchange_weak(most, now, std::memory_order_relaxed)) {
  }
  return p;
}

}  // namespace

extern "C" {
void* malloc(size_t size) {
  return added(__libc_malloc(size));
}
void* calloc(size_t count, size_t size) {
  return added(__libc_calloc(count, size));
}
void* realloc(void* p, size_t size) {
  in_use.fetch_sub(chunk_bytes(p), std::memory_order_relaxed);
  return added(__libc_realloc(p, size));
}
void* memalign(size_t alignment, size_t size) {
  return added(__libc_memalign(alignment, size));
}
void* aligned_alloc(size_t alignment, size_t size) {
  return memalign(alignment, size);
}
int posix_memalign(void** result, size_t alignment, size_t size) {
  *result = memalign(alignment, size);
  return *result == nullptr ? ENOMEM : 0;
}
void free(void* p) {
  in_use.fetch_sub(chunk_bytes(p), std::memory_order_relaxed);
  __libc_free(p);
}
}

namespace barycast::testing {

uint64_t bytes_in_use() {
  return in_use;
}
uint64_t bytes_in_use_max() {
  return in_use_max;
}
void reset_bytes_in_use_max() {
  in_use_max = in_use.load();
}

}  // namespace barycast::testing
