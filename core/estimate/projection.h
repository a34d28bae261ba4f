#pragma once

// From moments to the vectors u_v of every control vertex [SBC Eq. 7], in the cage's common frame:
// Lambda_v(y) = u_v . [y; 1] is the linear function that best fits phi_v over the samples; its value at
// the query is the coordinate [SBC Eq. 6, 10], its linear part the gradient [SBC 4.5].

#include <vector>

#include "cage/cage.h"
#include "estimate/moments.h"
#include "query/distance_index.h"

namespace barycast {

// u_v of one control vertex: gradient, then constant.
template <int D>
struct LinearFit {
  uint32_t vertex;
  Vec<D + 1> u;
};

// All u_v of one query. Pseudo-samples give every used vertex a share, which has rank d + 1 and stays
// implicit: u_v = fits[v].u (or 0) + pseudo [x_v; 1].
template <int D>
struct Projected {
  std::vector<LinearFit<D>> fits;  // ascending by vertex
  Mat<D + 1> pseudo = Mat<D + 1>::Zero();
  bool singular = false;  // pseudo-samples stepped in (kWhenSingular), or there were no samples
};

enum class PseudoSamples {
  kAlways,        // with weight kPseudoSampleWeight of a mean sample, spread over the used vertices
  kWhenSingular,  // only where the moment matrix cannot be inverted (paper preset)
  kNever,         // for signed weights, whose sums are smaller than any share of a mean sample
};

template <int D>
class Projection {
 public:
  explicit Projection(const Cage<D>& cage);

  // Solves for u_v [SBC Eq. 7]. Without samples: the affine least-squares fit of the control vertices.
  void project(const Moments<D>& moments, PseudoSamples policy, Projected<D>& out) const;

  // How much more noise signed weights let through than their magnitudes would, in standard deviations: in the
  // coordinates at x, and at worst in any other value or gradient of the fits. Outside, hits of either sign nearly
  // cancel: the second grows with the square of the distance. Infinite where M has no inverse.
  struct Amplification {
    double at_query, anywhere;
  };
  Amplification amplification(const Moments<D>& moments, const Vec<D>& x) const;
  // Whether either of them is certainly below a limit, by determinants: for most signed moments, at a tenth of the
  // cost. Answers false where it does not know.
  bool amplify_less(const Moments<D>& moments, double limit) const;

  // For a query on the cage at y: keeps every gradient and sets the constants so that u_v . [y; 1] =
  // phi_v(y) [SBC 4.4].
  void pin(const CagePoint<D>& y, Projected<D>& projected) const;

 private:
  double pseudo_weight(const Moments<D>& moments) const;
  // sum |w| Y Y^T, with pseudo-samples, so that it can be inverted.
  Mat<D + 1> magnitude(const Moments<D>& moments, const Mat<D + 1>& local) const;

  const Cage<D>& cage_;
  Mat<D + 1> vertex_second_;  // sum over used vertices of [x_v; 1] [x_v; 1]^T
};

extern template class Projection<2>;
extern template class Projection<3>;

}  // namespace barycast
