#include "accel/gpu_triangles.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include "core/trace_math.h"

namespace energyprof::accel {

std::vector<gpu::Triangle> gpu_triangles(const Mesh& mesh) {
  std::vector<gpu::Triangle> triangles(mesh.triangles.size());
  tbb::parallel_for(tbb::blocked_range<size_t>(0, mesh.triangles.size(), 16384), [&](const auto&
                                                                                         range) {
    for (size_t i = range.begin(); i < range.end(); ++i) {
      const glm::uvec3 corners = mesh.triangles[i];
      const glm::vec3 v0 = mesh.positions[corners.x];
      const glm::vec3 e1 = mesh.positions[corners.y] - v0;
      const glm::vec3 e2 = mesh.positions[corners.z] - v0;
      const glm::vec3 normal = gpu::cross3(e1, e2);
      triangles[i] = {glm::vec4(v0, normal.x), glm::vec4(e1, normal.y), glm::vec4(e2, normal.z)};
    }
  });
  return triangles;
}

}  // namespace energyprof::accel
