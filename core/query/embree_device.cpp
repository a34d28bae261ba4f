#include "query/embree_device.h"

#include <string>

namespace barycast {

RTCDevice embree_device() {
  static const RTCDevice instance = rtcNewDevice(nullptr);
  return instance;
}

Result<EmbreeScene> make_embree_scene(unsigned count, void* user, RTCBoundsFunction bounds,
                                      RTCIntersectFunctionN intersect) {
  RTCDevice device = embree_device();
  if (device == nullptr) return Error{ErrorCode::kInternal, "", "Embree could not be started"};
  EmbreeScene scene(rtcNewScene(device));
  if (intersect != nullptr) rtcSetSceneFlags(scene.get(), RTC_SCENE_FLAG_ROBUST);
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
  rtcSetGeometryUserPrimitiveCount(geometry, count);
  rtcSetGeometryUserData(geometry, user);
  rtcSetGeometryBoundsFunction(geometry, bounds, nullptr);
  if (intersect != nullptr) rtcSetGeometryIntersectFunction(geometry, intersect);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(scene.get(), geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(scene.get());
  if (const RTCError error = rtcGetDeviceError(device); error != RTC_ERROR_NONE)
    return Error{ErrorCode::kInternal, "", "Embree failed with error " + std::to_string(error)};
  return scene;
}

}  // namespace barycast
