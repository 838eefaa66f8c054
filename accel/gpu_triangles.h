/// Triangles as the kernels read them: corner, edges and normal, precomputed.
#pragma once

#include <vector>

#include "accel/mesh.h"
#include "core/gpu_layout.h"

namespace energyprof::accel {

/// In the order of mesh.triangles. All structures of a scene share them.
std::vector<gpu::Triangle> gpu_triangles(const Mesh& mesh);

}  // namespace energyprof::accel
