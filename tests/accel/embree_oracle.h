// Embree as an oracle: the closest hit of a ray, found by somebody else's code.
#pragma once

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "accel/mesh.h"
#include "accel/trace_cpu.h"
#include "core/trace_math.h"

namespace energyprof::test {

class EmbreeOracle {
 public:
  explicit EmbreeOracle(const accel::Mesh& mesh) : device_(rtcNewDevice("threads=1")) {
    scene_ = rtcNewScene(device_);
    rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
    if (!mesh.triangles.empty()) {
      RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
      auto* positions = static_cast<glm::vec3*>(
          rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                  sizeof(glm::vec3), mesh.positions.size()));
      std::copy(mesh.positions.begin(), mesh.positions.end(), positions);
      auto* triangles = static_cast<glm::uvec3*>(
          rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                  sizeof(glm::uvec3), mesh.triangles.size()));
      std::copy(mesh.triangles.begin(), mesh.triangles.end(), triangles);
      rtcCommitGeometry(geometry);
      rtcAttachGeometry(scene_, geometry);
      rtcReleaseGeometry(geometry);
    }
    rtcCommitScene(scene_);
  }
  ~EmbreeOracle() {
    rtcReleaseScene(scene_);
    rtcReleaseDevice(device_);
  }
  EmbreeOracle(const EmbreeOracle&) = delete;
  EmbreeOracle& operator=(const EmbreeOracle&) = delete;

  [[nodiscard]] gpu::Hit closest(const gpu::Ray& ray) const {
    RTCRayHit query{};
    query.ray = {ray.origin.x,
                 ray.origin.y,
                 ray.origin.z,
                 ray.t_min,
                 ray.direction.x,
                 ray.direction.y,
                 ray.direction.z,
                 0.0f,
                 ray.t_max,
                 0xFFFFFFFFu,
                 0,
                 0};
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    rtcIntersect1(scene_, &query, nullptr);
#else
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(scene_, &context, &query);
#endif
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return gpu::no_hit(ray);
    return {query.ray.tfar, query.hit.primID + 1};
  }

 private:
  RTCDevice device_;
  RTCScene scene_ = nullptr;
};

/// Pixels of a frame where Embree sees another triangle at another distance: t may differ by 1e-5,
/// and by four units in the last place of the scene's coordinates; at the same distance either
/// triangle will do. The bounce ray is the one from our own hit.
inline size_t pixels_unlike_embree(const EmbreeOracle& oracle, const accel::Mesh& mesh,
                                   const std::vector<gpu::Triangle>& triangles,
                                   const gpu::FrameConstants& constants,
                                   const std::vector<gpu::PixelHits>& hits) {
  const accel::Bounds box = accel::bounds(mesh);
  const glm::vec3 reach = glm::max(glm::abs(box.min), glm::abs(box.max));
  const float resolution = 0x1p-21f * std::max(reach.x, std::max(reach.y, reach.z));
  const auto alike = [&](const gpu::Hit& expected, uint32_t id, uint32_t t_bits) {
    if (expected.prim_id == 0 || id == 0) return expected.prim_id == id;
    const float t = gpu::uintBitsToFloat(t_bits);
    return std::fabs(expected.t - t) <= 1e-5f * t + resolution;
  };
  size_t count = 0;
  for (uint32_t y = 0; y < constants.height; ++y)
    for (uint32_t x = 0; x < constants.width; ++x) {
      const uint32_t pixel = y * constants.width + x;
      const gpu::PixelHits& seen = hits[pixel];
      const gpu::Ray primary = gpu::primary_ray(constants, x, y);
      bool same = alike(oracle.closest(primary), seen.primary_id, seen.primary_t);
      if (seen.bounce_id != gpu::ray_absent && seen.primary_id != 0) {
        const gpu::Triangle& triangle = triangles[seen.primary_id - 1];
        const glm::vec3 normal(triangle.v0_nx.w, triangle.e1_ny.w, triangle.e2_nz.w);
        const gpu::Ray bounce = gpu::bounce_ray(
            constants, primary, gpu::uintBitsToFloat(seen.primary_t), normal, pixel);
        same = same && alike(oracle.closest(bounce), seen.bounce_id, seen.bounce_t);
      }
      if (!same) ++count;
    }
  return count;
}

}  // namespace energyprof::test
