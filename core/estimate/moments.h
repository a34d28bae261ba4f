#pragma once

// Moments of the samples of one query [SBC Eq. 8, 9], summed in double and in the order of samples, in
// a frame centred on the samples and scaled to their spread, where the matrix is well conditioned.

#include <span>
#include <vector>

#include "cage/cage.h"
#include "sample/sample.h"

namespace barycast {

// m_v of one control vertex.
template <int D>
struct VertexMoment {
  uint32_t vertex;
  Vec<D + 1> moment;
};

// With Y = [(y - centre) scale; 1]: second = sum w Y Y^T, first = sum w phi_v Y for every vertex that a
// sample touches, ascending; centre and scale by |w|.
template <int D>
struct Moments {
  Vec<D> centre = Vec<D>::Zero();
  double scale = 1.0;
  Mat<D + 1> second = Mat<D + 1>::Zero();
  std::vector<VertexMoment<D>> first;
  Mat<D + 1> negative = Mat<D + 1>::Zero();  // the part of `second` from negative weights
  bool is_signed = false;                    // there are such
  double weight_mean = 0.0;                  // of |w|
  size_t sample_count = 0;

  // Keeps its memory.
  void clear() {
    std::vector<VertexMoment<D>> memory = std::move(first);
    memory.clear();
    *this = {};
    first = std::move(memory);
  }
};

enum class Weights { kAsGiven, kMagnitudes };

// Reusable workspace, one per task: memory for every control vertex.
template <int D>
class MomentAccumulator {
 public:
  explicit MomentAccumulator(const Cage<D>& cage);
  // kMagnitudes: as if every weight were |w|.
  void accumulate(std::span<const Sample<D>> samples, Weights weights, Moments<D>& out);

 private:
  const Cage<D>& cage_;
  std::vector<Eigen::Vector4d> by_vertex_;  // in the plane three of them
  std::vector<uint8_t> touched_;  // of every control vertex, 0 or 1, and some more; a bit would wait for the last one
};

extern template class MomentAccumulator<2>;
extern template class MomentAccumulator<3>;

}  // namespace barycast
