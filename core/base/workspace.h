#pragma once

// One object per thread, made on first use: memory that tasks reuse. Nothing in it may carry over into
// a result.

#include <tbb/enumerable_thread_specific.h>

namespace barycast {

template <class T>
class PerThread {
 public:
  template <class Make>
  explicit PerThread(Make make) : objects_(make) {}
  T& local() { return objects_.local(); }

 private:
  tbb::enumerable_thread_specific<T> objects_;
};

}  // namespace barycast
