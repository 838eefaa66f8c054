/// Triangles as the kernels read them: corner, edges and normal, precomputed.
#pragma once

#include <cstddef>
#include <vector>

#include "accel/mesh.h"

namespace energyprof::accel {

/// gpu::Triangle[] in the order of mesh.triangles, as bytes.
std::vector<std::byte> gpu_triangles(const Mesh& mesh);

}  // namespace energyprof::accel
