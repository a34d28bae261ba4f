#pragma once

// What the engines on Embree share: its device, scenes that release themselves, boxes in floats. Private to
// `query`.

#include <embree3/rtcore.h>

#include <cmath>
#include <memory>

#include "base/result.h"
#include "base/vector.h"

namespace barycast {

// One for the process, never released: Embree's own threads are not used (it builds on the caller's TBB
// arena), and releasing it at exit would race with static destruction.
RTCDevice embree_device();

struct EmbreeSceneDeleter {
  void operator()(RTCScene scene) const { rtcReleaseScene(scene); }
};
using EmbreeScene = std::unique_ptr<RTCSceneTy, EmbreeSceneDeleter>;

// A scene of one user geometry with `count` primitives, whose functions see `user`. `intersect` may be null.
// Errors: kInternal.
Result<EmbreeScene> make_embree_scene(unsigned count, void* user, RTCBoundsFunction bounds,
                                      RTCIntersectFunctionN intersect);

// The box of some points, rounded outwards and padded.
template <int D>
RTCBounds embree_box(const Vec<D>& low, const Vec<D>& high, double padding) {
  float bounds[6] = {0, 0, -1e-3f, 0, 0, 1e-3f};  // in the plane: thin in z
  for (int i = 0; i < D; ++i) {
    bounds[i] = std::nextafter(static_cast<float>(low[i] - padding), -1.0f);
    bounds[3 + i] = std::nextafter(static_cast<float>(high[i] + padding), 1.0f);
  }
  return {bounds[0], bounds[1], bounds[2], 0, bounds[3], bounds[4], bounds[5], 0};
}

}  // namespace barycast
