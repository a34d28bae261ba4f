#include "bind/sampler.h"

#include "query/line_index.h"

namespace barycast {

template <int D>
Sampler<D> make_sampler(const ResolvedOptions& options, const CageStructures<D>& structures) {
  const bool paper = options.preset == Preset::kPaper;
  if (options.coordinates != CoordinateKind::kHarmonic)
    return RaySamples<D>(structures.cage, *structures.lines,
                         {.rays = options.samples,
                          .visible_only = options.coordinates == CoordinateKind::kPositiveMeanValue,
                          .as_printed = paper});
  return HarmonicWalks<D>(*structures.walks, {.walks = options.samples,
                                              .thickness = options.thickness,
                                              .walk_steps_max = options.walk_steps_max,
                                              .as_printed = paper});
}

template Sampler<2> make_sampler(const ResolvedOptions&, const CageStructures<2>&);
template Sampler<3> make_sampler(const ResolvedOptions&, const CageStructures<3>&);

}  // namespace barycast
